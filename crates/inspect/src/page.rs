//! `inspect.html`: one file with nothing outside it.

mod figures;

pub(crate) use figures::similarity;

use crate::output::MARK;
use crate::words::{count, facts, length, numbers};
use crate::{Divided, Flip, Inspection, Outcome};
use minijinja::{Value, context};
use pwrfgs_core::Result;
use pwrfgs_experiment::repeatability::Lapse;
use pwrfgs_experiment::text::number;
use pwrfgs_report::fill;

impl Inspection<'_> {
    /// The page.
    ///
    /// # Errors
    /// [`pwrfgs_core::Error::Config`] where its template is wrong, as tests check.
    pub fn page(&self) -> Result<String> {
        let words: Vec<(&str, String)> = facts(self).into_iter().filter(|(name, _)| *name != "numbers").collect();
        let pose = self.pose.as_ref().map(|pose| {
            let recorded = ("as recorded: x, y, z, w", pose.recorded);
            let turned = ("as recorded, and the best rotation", pose.turned);
            let constant = ("one constant direction", pose.constant);
            let rows = [recorded, turned, constant].into_iter().chain(pose.readings.clone());
            let flip = |flip: &Flip| {
                let turned = if flip.is_turned { ", and the best rotation" } else { "" };
                (format!("{}{turned}", flip.name), flip.angle)
            };
            let rows = rows.map(|(name, angle)| (name.to_owned(), angle)).chain(pose.flips.iter().map(flip));
            context! {
                title => pose.verdict.title(),
                sentences => pose.sentences(),
                rows => rows.map(|(name, angle)| (name, format!("{angle:.1}°"))).collect::<Vec<_>>(),
                figures => figures::pose(pose),
                rings => figures::rings(pose).map(|degrees| degrees.to_string()),
            }
        });
        let refused =
            self.splits.iter().filter_map(|d| d.outcome.as_ref().err().map(|why| (d.name.clone(), why.clone())));
        let page = context! {
            mark => Value::from_safe_string(MARK.into()),
            version => env!("CARGO_PKG_VERSION"),
            title => format!("{}{}", self.data.title, self.mark()),
            simulated => self.data.is_simulated(),
            facts => words,
            positions => figures::positions(self),
            time_bar => figures::time_bar(self.trajectory.ids),
            drawn => (self.trajectory.samples > figures::DOTS).then(|| count(figures::DOTS)),
            observations => self.data.task().counted[1],
            placed => self.data.placed,
            pictures => self.pictures.as_ref().map(|(pictures, freedom)| context! {
                sheet => figures::sheet(self.data),
                sheet_of => figures::SHEET.min(self.trajectory.samples),
                mean => figures::mean(pictures, &self.data.plane()),
                freedom => numbers(freedom),
                freedom_figure => figures::freedom(freedom),
            }),
            pose,
            distances => figures::distances(&self.splits),
            splits => self.splits.iter().filter_map(row).collect::<Vec<_>>(),
            bounds => self.splits.iter().filter_map(|d| d.outcome.as_ref().ok()).any(|o| o.floors.iter().any(|f| f.knows_scene)),
            refused => refused.collect::<Vec<_>>(),
            tables => self.tables(),
            ceiling => self.ceiling_page(),
        };
        fill(include_str!("page/inspect.html"), page)
    }

    /// One table a metric: splits by predictors.
    fn tables(&self) -> Vec<Value> {
        let outcomes: Vec<(&Divided, &Outcome)> =
            self.splits.iter().filter_map(|d| Some((d, d.outcome.as_ref().ok()?))).collect();
        let Some((_, first)) = outcomes.first() else { return Vec::new() };
        let keys =
            first.floors.first().map_or_else(Vec::new, |f| f.scores.iter().map(|s| (s.0.clone(), s.1)).collect());
        let table = |(key, higher): (String, bool)| {
            let cell = |o: &Outcome, f: usize| {
                let scores = o.floors.get(f).into_iter().flat_map(|floor| &floor.scores);
                let score = scores.filter(|s| s.0 == key).map(|s| s.2).next();
                score.map_or_else(|| "n/a".into(), |s| format!("{} / {}", number(s.mean), number(s.median)))
            };
            let both = |mean, median| format!("{} / {}", number(mean), number(median));
            let ceiling = |o: &Outcome| {
                let known = self.ceiling_of(&key, o);
                let kind = if o.lapse == Lapse::Near { "near in time" } else { "far apart in time" };
                known.map_or_else(|| "not known".into(), |[mean, median]| format!("{}, {kind}", both(mean, median)))
            };
            let row = |(d, o): &(&Divided, &Outcome)| {
                let cells = (0..first.floors.len()).map(|f| cell(o, f)).chain([ceiling(o)]);
                (d.name.clone(), cells.collect::<Vec<_>>())
            };
            let names = first.floors.iter().map(|f| format!("{}{}", f.name, if f.knows_scene { " †" } else { "" }));
            let names: Vec<String> = names.chain(["ceiling".to_owned()]).collect();
            let (rows, ceiling) = (outcomes.iter().map(row).collect::<Vec<_>>(), self.ceiling_words(&key));
            context! { key, higher, names, rows, ceiling }
        };
        keys.into_iter().map(table).collect()
    }
}

/// A split's row in the table of distances.
fn row(divided: &Divided) -> Option<Value> {
    let outcome = divided.outcome.as_ref().ok()?;
    Some(context! {
        name => divided.name.clone(),
        own => divided.own,
        samples => outcome.samples.map(count),
        distances => [0.1, 0.5, 0.9].map(|q| length(outcome.distance(q))),
        tested => outcome.tested,
    })
}
