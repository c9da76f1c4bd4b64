//! The findings in a terminal: short, the same as on the page.

use crate::words::{facts, length};
use crate::{Divided, Inspection};
use pwrfgs_experiment::text::{aligned, number};
use std::fmt::Write as _;

/// Width of lines of prose.
const WIDTH: usize = 100;

impl Inspection<'_> {
    /// Facts, the verdict on the pose and a table of splits.
    pub fn text(&self) -> String {
        let mut text = format!("{}{}\n\n", self.data.title, self.mark());
        for (name, words) in facts(self) {
            text += &wrapped(&format!("{name:<15}"), &words);
        }
        match &self.pose {
            Some(pose) => {
                text += &wrapped(&format!("{:<15}", "pose"), pose.verdict.title());
                pose.sentences().iter().for_each(|s| text += &wrapped(&" ".repeat(15), s));
            }
            None if self.pictures.is_none() => {}
            None => {
                text += &wrapped(&format!("{:<15}", "pose"), "too few pictures with a strongest direction to tell.");
            }
        }
        text.push('\n');
        text + &self.table()
    }

    /// Says that data are simulated where their title does not.
    pub(crate) fn mark(&self) -> &'static str {
        let said = self.data.title.to_lowercase().contains("simulated");
        if self.data.is_simulated() && !said { " (simulated)" } else { "" }
    }

    /// Splits with their distances and what predictors reach by the first metric.
    fn table(&self) -> String {
        let given = |d: &Divided| d.outcome.as_ref().ok().map(|o| o.floors.clone());
        let Some(floors) = self.splits.iter().find_map(given) else { return String::new() };
        let Some(first) = floors.first().and_then(|f| f.scores.first()).map(|s| s.0.clone()) else {
            return String::new();
        };
        let head = ["split", "train", "test", "nearest training"].map(str::to_owned);
        let names = floors.iter().map(|f| f.name.clone()).chain(["ceiling".to_owned()]);
        let mut lines: Vec<Vec<String>> = vec![head.into_iter().chain(names).collect()];
        let mut refused = String::new();
        for divided in &self.splits {
            match &divided.outcome {
                Ok(o) => {
                    let mut line = vec![divided.name.clone(), o.samples[0].to_string(), o.samples[2].to_string()];
                    line.push(length(o.distance(0.5)));
                    line.extend(o.floors.iter().map(|f| f.scores.first().map_or("n/a".into(), |s| number(s.2.mean))));
                    line.push(self.ceiling_of(&first, o).map_or_else(|| "n/a".into(), |c| number(c[0])));
                    lines.push(line);
                }
                Err(why) => _ = writeln!(refused, "{}: {why}", divided.name),
            }
        }
        let tested = self.splits.iter().filter_map(|d| d.outcome.as_ref().ok()).map(|o| o.tested).max().unwrap_or(0);
        let note = format!(
            "note: mean {first} of predictors without a model, on up to {tested} test {} each; nearest training: \
             median distance from a test transmitter\n",
            self.data.task().counted[1]
        );
        let text = aligned(&lines, 1) + &refused + &note;
        self.ceiling_words(&first).iter().fold(text, |text, words| text + "note: " + words + "\n")
    }
}

/// Words broken into lines, the first with `head` before it and the others as far in.
fn wrapped(head: &str, words: &str) -> String {
    let indent = head.chars().count();
    let (mut text, mut column) = (head.to_owned(), indent);
    for word in words.split_whitespace() {
        let long = word.chars().count();
        if column > indent && column + 1 + long > WIDTH {
            text = text.trim_end().to_owned() + "\n" + &" ".repeat(indent);
            column = indent;
        }
        if column > indent {
            text.push(' ');
            column += 1;
        }
        text += word;
        column += long;
    }
    text.trim_end().to_owned() + "\n"
}

#[cfg(test)]
mod tests {
    use super::wrapped;

    #[test]
    fn prose_is_broken_and_indented() {
        let text = wrapped("pose   ", &"twelve chars ".repeat(20));
        assert!(text.lines().all(|line| line.chars().count() <= super::WIDTH));
        assert!(
            text.starts_with("pose   twelve")
                && text.lines().skip(1).all(|line| line.starts_with("       t") || line.starts_with("       c"))
        );
    }
}
