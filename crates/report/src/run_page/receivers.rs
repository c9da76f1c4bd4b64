//! A table with a row a receiver: how well each is predicted, by the model and by every baseline.

use minijinja::{Value, context};
use pwrfgs_experiment::LoadedRun;
use pwrfgs_experiment::statistics::Summary;
use pwrfgs_experiment::text::number;

/// Most rows; the others are counted.
const ROWS: usize = 60;

/// Mean and median of the first metric over the test links of each receiver; nothing where there is one receiver, or no
/// predictor has a number a link.
pub(super) fn table(run: &LoadedRun<'_>) -> Option<Value> {
    let (data, scores) = (run.data, &run.record.scores);
    let headline = data.task().headline;
    let receivers = &data.scene.receivers;
    if receivers.len() < 2 {
        return None;
    }
    let mut of_each: Vec<Vec<usize>> = vec![Vec::new(); receivers.len()];
    for (place, &i) in run.partition.test.iter().enumerate() {
        of_each[data.links[i].receiver].push(place);
    }
    let predictors: Vec<(&String, &[f64])> =
        scores.predictors.iter().filter_map(|(name, _)| Some((name, scores.samples(name, headline.key)?))).collect();
    let heard: Vec<usize> = (0..receivers.len()).filter(|&r| !of_each[r].is_empty()).collect();
    let row = |&r: &usize| {
        let summaries: Vec<Summary> = predictors
            .iter()
            .map(|(_, values)| of_each[r].iter().filter_map(|&k| values.get(k).copied()).collect::<Vec<f64>>())
            .map(|own| Summary::of(&own, headline.higher))
            .collect();
        let cells: Vec<(String, &str)> = summaries
            .iter()
            .flat_map(|own| {
                let rivals = || summaries.iter();
                [
                    marked(own.mean, rivals().map(|other| other.mean), headline.higher),
                    marked(own.median, rivals().map(|other| other.median), headline.higher),
                ]
            })
            .collect();
        context! { name => receivers[r].name.clone(), links => of_each[r].len(), cells }
    };
    (!predictors.is_empty() && !heard.is_empty()).then(|| {
        context! {
            metric => headline.name,
            predictors => predictors.iter().map(|(name, _)| (*name).clone()).collect::<Vec<_>>(),
            rows => heard.iter().take(ROWS).map(row).collect::<Vec<_>>(),
            unshown => heard.len().saturating_sub(ROWS),
            silent => receivers.len() - heard.len(),
        }
    })
}

/// A number, and whether none is better.
fn marked(value: f64, mut all: impl Iterator<Item = f64>, higher: bool) -> (String, &'static str) {
    let is_best = value.is_finite() && all.all(|other| !(if higher { other > value } else { other < value }));
    (number(value), if is_best { "best" } else { "" })
}

#[cfg(test)]
mod tests {
    use super::marked;

    #[test]
    fn the_best_of_a_row_is_marked() {
        assert_eq!(marked(2.0, [2.0, 3.0].into_iter(), false).1, "best");
        assert_eq!(marked(2.0, [2.0, 3.0].into_iter(), true).1, "");
        assert_eq!(marked(f64::NAN, [f64::NAN].into_iter(), true).1, "");
    }
}
