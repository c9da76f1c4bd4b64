//! Score table as text for a terminal.

use crate::scores::{CEILING, MODEL, ScoreCell, ScoreTable};
use crate::text::{align_columns, grouped, number};

impl ScoreTable {
    /// Describes the numbers of test samples and of training samples of the model and the baselines; empty if unknown.
    pub fn heading(&self) -> String {
        let [model, baselines, test] = self.samples;
        if test == 0 {
            return String::new();
        }
        let has_baselines = self.predictors.iter().skip(1 + self.members.len()).any(|name| name != CEILING);
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

    /// Formats aligned text for a terminal: heading, one line per metric and statistic, one column per predictor. The
    /// best value of a line is marked `*`, an oracle baseline `†`. Paired differences and notes follow.
    pub fn to_text(&self) -> String {
        let share = self.share.map_or_else(String::new, |share| format!(" (b = {share})"));
        let mark = |name: &String| match () {
            () if self.oracles.contains(name) => " †",
            () if name == MODEL => &share,
            () => "",
        };
        let name = |name: &String| format!("{name}{}", mark(name));
        let head = ["metric".to_owned(), String::new()].into_iter().chain(self.predictors.iter().map(name));
        let mut lines: Vec<Vec<String>> = vec![head.collect()];
        for row in &self.metrics {
            let arrow = if row.higher_is_better { "↑" } else { "↓" };
            let unit = if row.unit.is_empty() { String::new() } else { format!(" [{}]", row.unit) };
            let statistics: &[&str] = match (row.is_per_sample(), row.higher_is_better) {
                (false, _) => &[""],
                (true, true) => &["mean", "median", "10th percentile"],
                (true, false) => &["mean", "median", "90th percentile"],
            };
            for (k, statistic) in statistics.iter().enumerate() {
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
        let things = self.task.counted[1];
        let oracle = format!(
            "† oracle baseline: uses the scene of simulated {things}, or the time of measured ones; not ranked"
        );
        let legend = (!self.oracles.is_empty()).then_some(oracle);
        let pairs = self.paired.as_ref().map(|paired| paired.note(self.task));
        let notes = legend.iter().chain(&pairs).chain(&self.notes);
        let heading = Some(self.heading() + "\n").filter(|text| text.len() > 1).unwrap_or_default();
        let differences =
            self.paired.as_ref().map_or_else(String::new, |pairs| align_columns(&pairs.lines(&self.oracles), 1) + "\n");
        let text = heading + &align_columns(&lines, 2) + "\n" + &differences;
        notes.fold(text, |text, note| text + "note: " + note + "\n")
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
