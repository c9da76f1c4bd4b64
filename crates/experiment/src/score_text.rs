//! Score table as text for a terminal: the verdict, then the main metrics of the task or all.

use crate::paired::{Paired, is_custom};
use crate::scores::{MODEL, MetricRow, ScoreCell, ScoreTable};
use crate::text::{align_columns, grouped, number};

impl ScoreTable {
    /// Describes the numbers of test samples and of training samples of the model and the baselines; empty if unknown.
    pub fn heading(&self) -> String {
        let [model, baselines, test] = self.samples;
        if test == 0 {
            return String::new();
        }
        let has_baselines = self.baselines().next().is_some();
        let [of_model, of_baselines, tested] = self.samples.map(|n| grouped(n as i64));
        let trained = if has_baselines && model == baselines && !self.trained_elsewhere {
            vec![format!("model and baselines are trained on the same {of_model}")]
        } else {
            let of_model = (model > 0).then(|| format!("the model is trained on {of_model}"));
            let of_baselines = format!("the baselines are trained on {of_baselines} (training and validation)");
            of_model.into_iter().chain(has_baselines.then_some(of_baselines)).collect()
        };
        [vec![format!("{tested} test {}", self.task.counted[1])], trained].concat().join("; ")
    }

    /// Compares the model with the best ranked baseline by the first metric, from [`Self::paired`]:
    /// `level with Kriging: +0.0030 [−0.0030, +0.0080] (..)`. `None` without such a baseline.
    pub fn verdict(&self) -> Option<String> {
        let headline = self.task.headline;
        let metric = self.metrics.iter().find(|metric| metric.key == headline.key)?;
        let ranks = self.ranks(metric, 0);
        let rank = |name: &str| ranks[self.predictors.iter().position(|predictor| predictor == name)?];
        let ranked = self.baselines().filter_map(|name| Some((rank(name)?, name)));
        let (_, best) = ranked.min_by_key(|(rank, _)| *rank)?;
        let row = self.paired.as_ref()?.row(best, headline.key)?;
        let arrow = if headline.higher { "↑" } else { "↓" };
        Some(format!("{} (model minus baseline, mean {} {arrow})", row.sentence(), headline.name))
    }

    /// Returns the metrics of a short table, in the order of the pipeline: those of the task and of users; if these are
    /// fewer than four, the first others too.
    pub fn main_metrics(&self) -> Vec<&MetricRow> {
        let main = self.task.main_metrics;
        let is_main = |row: &&MetricRow| main.contains(&row.key.as_str()) || is_custom(&row.key);
        let free = main.len().saturating_sub(self.metrics.iter().filter(is_main).count());
        let others = self.metrics.iter().filter(|row| !is_main(row));
        let fillers: Vec<&str> = others.take(free).map(|row| row.key.as_str()).collect();
        self.metrics.iter().filter(|row| is_main(row) || fillers.contains(&row.key.as_str())).collect()
    }

    /// Formats aligned text for a terminal: verdict, heading, one line per metric, one column per predictor. The best
    /// value of a line is marked `*`, an oracle baseline `†`. Paired differences and notes follow.
    ///
    /// The words `elsewhere`, such as `--all also prints`, select the short table: the main metrics of the task, of which
    /// only the first one has its median and percentile. A note of these words and the other metrics follows.
    pub fn to_text(&self, elsewhere: Option<&str>) -> String {
        let all = elsewhere.is_none();
        let shown = if all { self.metrics.iter().collect() } else { self.main_metrics() };
        let hidden = self.metrics.iter().map(|row| &row.key).filter(|key| !shown.iter().any(|row| row.key == **key));
        let hidden: Vec<&str> = hidden.map(String::as_str).collect();
        let things = self.task.counted[1];
        let oracle = format!(
            "† oracle baseline: uses the scene of simulated {things}, or the time of measured ones; not ranked"
        );
        let legend = (!self.oracles.is_empty()).then_some(oracle);
        let rows = |paired: &Paired| {
            let rows = paired.rows.iter().filter(|pair| shown.iter().any(|row| row.key == pair.metric));
            Paired { rows: rows.cloned().collect(), ..paired.clone() }
        };
        let pairs = self.paired.as_ref().map(rows).filter(|paired| !paired.rows.is_empty());
        let note = pairs.as_ref().map(|paired| paired.note(self.task));
        let more = elsewhere.filter(|_| !hidden.is_empty()).map(|words| format!("{words} {}", hidden.join(", ")));
        let verdict = self.verdict().map(|verdict| format!("The model is {verdict}"));
        let heading = verdict.into_iter().chain(Some(self.heading()).filter(|text| !text.is_empty()));
        let text =
            heading.fold(String::new(), |text, line| text + &line + "\n") + &self.format_metrics(&shown, all) + "\n";
        let text = pairs.iter().fold(text, |text, pairs| text + &align_columns(&pairs.lines(&self.oracles), 1) + "\n");
        let notes = legend.iter().chain(&note).chain(&self.notes).chain(&more);
        notes.fold(text, |text, note| text + "note: " + note + "\n")
    }

    /// Formats the table of the metrics `shown`. A metric of samples has mean, median and percentile if `all`, or if it is the
    /// first of the task; otherwise the mean alone.
    fn format_metrics(&self, shown: &[&MetricRow], all: bool) -> String {
        let share = self.share.map_or_else(String::new, |share| format!(" (b = {share})"));
        let name = |name: &String| match name.as_str() {
            _ if self.oracles.contains(name) => format!("{name} †"),
            MODEL => format!("{name}{share}"),
            _ => name.clone(),
        };
        let head = ["metric".to_owned(), String::new()].into_iter().chain(self.predictors.iter().map(name));
        let mut lines: Vec<Vec<String>> = vec![head.collect()];
        for row in shown {
            let arrow = if row.higher_is_better { "↑" } else { "↓" };
            let unit = if row.unit.is_empty() { String::new() } else { format!(" [{}]", row.unit) };
            let statistics: &[&str] = match (row.is_per_sample(), row.higher_is_better) {
                (false, _) => &[""],
                (true, true) => &["mean", "median", "10th percentile"],
                (true, false) => &["mean", "median", "90th percentile"],
            };
            let count = if all || row.key == self.task.headline.key { statistics.len() } else { 1 };
            for (k, statistic) in statistics[..count].iter().enumerate() {
                let name = if k == 0 { format!("{}{unit} {arrow}", row.key) } else { String::new() };
                let ranks = self.ranks(row, k);
                let alone = ranks.iter().flatten().count() < 2;
                let cell = |(cell, rank): (&ScoreCell, &Option<usize>)| match cell.numbers().get(k) {
                    Some(value) => format!("{}{}", number(*value), if *rank == Some(0) && !alone { "*" } else { " " }),
                    None => "n/a ".to_owned(),
                };
                let cells = row.cells.iter().zip(&ranks).map(cell);
                lines.push([name, (*statistic).to_owned()].into_iter().chain(cells).collect());
            }
        }
        align_columns(&lines, 2)
    }
}

#[cfg(test)]
mod tests {
    use crate::paired::{Paired, PairedRow};
    use crate::scores::{CEILING, MODEL, MetricRow, ScoreCell, ScoreTable};
    use crate::statistics::Summary;

    #[test]
    fn verdict_names_the_best_ranked_baseline() {
        let verdict = |interval: Option<[f64; 2]>, oracles: &[&str]| {
            let cell = |mean| ScoreCell::Samples(Summary { mean, median: mean, tail10: mean });
            let row = |baseline: &str| PairedRow {
                baseline: baseline.into(),
                metric: "ssim".into(),
                higher_is_better: true,
                mean: 0.003,
                interval,
            };
            let table = ScoreTable {
                predictors: [MODEL, "3-NN", "Kriging", "RT exact", CEILING].map(str::to_owned).into(),
                metrics: vec![MetricRow {
                    key: "ssim".into(),
                    unit: String::new(),
                    higher_is_better: true,
                    cells: [0.8, 0.7, 0.797, 0.99, 1.0].map(cell).into(),
                }],
                oracles: oracles.iter().map(|name| (*name).to_owned()).collect(),
                paired: Some(Paired { edge_m: None, cubes: 9, rows: ["3-NN", "Kriging"].map(row).into() }),
                ..ScoreTable::default()
            };
            table.verdict()
        };
        let verdict_of = |interval| verdict(interval, &["RT exact"]).unwrap();
        let end = " (model minus baseline, mean SSIM ↑)";
        assert_eq!(verdict_of(Some([-0.003, 0.008])), format!("level with Kriging: +0.0030 [−0.0030, +0.0080]{end}"));
        assert_eq!(verdict_of(Some([0.001, 0.008])), format!("ahead of Kriging: +0.0030 [+0.0010, +0.0080]{end}"));
        assert_eq!(verdict_of(None), format!("not compared by an interval with Kriging: +0.0030{end}"));
        assert_eq!(verdict(None, &["3-NN", "Kriging", "RT exact"]), None);
    }
}
