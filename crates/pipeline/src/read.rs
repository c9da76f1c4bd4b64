//! Reads a pipeline and checks that data, method, metrics and pruners fit together.

use crate::changes::{line_and_column, shortened};
use crate::defaults;
use crate::pipeline::Pipeline;
use crate::ron_tree::RonTree;
use pwrfgs_core::plugin::{explain, name_of, ron_options, to_ron};
use pwrfgs_core::{Dataset, Demand, Error, Misfit, Parts, Result, Task, check_compatible};
use pwrfgs_methods::Calibration;
use pwrfgs_model::file::MOST_MEMBERS;
use ron::error::SpannedError;
use std::path::Path;

/// Problem of a pipeline text.
#[derive(Debug)]
pub(crate) struct TextFault {
    pub(crate) message: String,
    /// Position, as a byte index of the text; `None` if it is unknown.
    pub(crate) at: Option<usize>,
    pub(crate) hint: TypeHint,
}

/// Whether a message should add the type that the value at its position has to have.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum TypeHint {
    /// No: the message is complete without it.
    Never,
    /// If the value has no parts; otherwise, one of its parts may be wrong.
    AtLeaf,
    /// Yes: the value is of another type.
    Always,
}

impl TextFault {
    /// Creates the fault for a syntax or type error of the text.
    fn of_parser(error: &SpannedError, text: &str) -> Self {
        let hint = match error.code {
            ron::Error::Message(_) => TypeHint::AtLeaf,
            ron::Error::NoSuchEnumVariant { .. }
            | ron::Error::NoSuchStructField { .. }
            | ron::Error::MissingStructField { .. } => TypeHint::Never,
            _ => TypeHint::Always,
        };
        let end = error.span.end;
        let line_start = text.split_inclusive('\n').take(end.line - 1).map(str::len).sum::<usize>();
        let column = text[line_start..].char_indices().nth(end.col - 1).map_or(text.len() - line_start, |(i, _)| i);
        Self { message: explain(error), at: Some(line_start + column), hint }
    }

    /// Creates the fault for a `field` that does not fit the others; at the data if the field was omitted.
    pub(crate) fn of(field: &str, message: String, tree: &RonTree) -> Self {
        let value = tree.field(field).or_else(|| tree.field("data"));
        Self { message, at: value.map(|value| value.span.start), hint: TypeHint::Never }
    }
}

impl Pipeline {
    /// Reads a pipeline; `path` is used only in messages.
    ///
    /// # Errors
    /// [`Error::Input`] with line and column if the text is not a valid pipeline.
    pub fn parse(text: &str, path: &Path) -> Result<Self> {
        Self::parse_with_fault(text).map_err(|TextFault { message, at, .. }| Error::Input {
            path: path.into(),
            at: at.map(|at| line_and_column(text, at)),
            message,
        })
    }

    /// Same as [`Self::parse`]; the error has a byte position and a type hint.
    pub(crate) fn parse_with_fault(text: &str) -> Result<Self, TextFault> {
        let mut pipeline: Self = ron_options().from_str(text).map_err(|e| TextFault::of_parser(&e, text))?;
        let tree = RonTree::parse(text).map_err(|message| TextFault { message, at: None, hint: TypeHint::Never })?;
        pipeline.set_dependent_defaults(&|field| tree.field(field).is_none()).map_err(|message| TextFault {
            message,
            at: Some(tree.span.end),
            hint: TypeHint::Never,
        })?;
        pipeline.check().map_err(|(field, message)| TextFault::of(&field, message, &tree))?;
        Ok(pipeline)
    }

    /// Sets the fields that were `left_out` and whose default depends on the task; those of spectra if the task is not known yet.
    ///
    /// # Errors
    /// A method with Gaussians has no initialiser.
    fn set_dependent_defaults(&mut self, left_out: &dyn Fn(&str) -> bool) -> Result<(), String> {
        if left_out("initializer") && self.method.as_ref().is_none_or(|method| method.traits().has_gaussians()) {
            return Err("the field `initializer` is missing".into());
        }
        let task = self.data.task().unwrap_or_default();
        if left_out("readout") {
            self.readout = defaults::readout(task);
        }
        if left_out("baselines") {
            self.baselines = defaults::baselines(task);
        }
        if left_out("metrics") {
            self.metrics = defaults::metrics(task);
        }
        Ok(())
    }

    /// Checks that all baselines and metrics support `data`.
    ///
    /// # Errors
    /// A baseline or metric does not support `data`, predictions of another program are missing or invalid, or the split,
    /// which selects their test set, returns an error. A message names the field of the first error.
    pub fn check_data(&self, data: &Dataset) -> Result<(), Error> {
        let named = |field: &str, error: Error| match error {
            Error::Config(_) | Error::Input { .. } | Error::Read { .. } => Error::Config(format!("{field}: {error}")),
            other => other, // an exception of Python's stays one
        };
        check_compatible(&Parts { data: Some(data), demands: &self.scoring_demands(), ..Parts::default() })
            .map_err(Misfit::error)?;
        for baseline in &self.baselines {
            baseline.check_data(data).map_err(|error| named("baselines", error))?;
        }
        if self.baselines.iter().any(|baseline| baseline.is_external()) {
            self.check_external(data, &self.partition(data)?.test).map_err(|error| named("baselines", error))?;
        }
        for metric in &self.metrics {
            metric.check_data(data).map_err(|error| named("metrics", error))?;
        }
        Ok(())
    }

    /// Checks the predictions of other programs for the links `test`.
    ///
    /// # Errors
    /// Missing or invalid predictions, or two baselines of one name.
    pub fn check_external(&self, data: &Dataset, test: &[usize]) -> Result<(), Error> {
        let count_of =
            |name: &str| self.baselines.iter().filter(|baseline| baseline.name_for(data.task()) == name).count();
        for baseline in self.baselines.iter().filter(|baseline| baseline.is_external()) {
            if count_of(&baseline.name()) != 1 {
                let problem = format!("two baselines are called `{}`; rename the predictions", baseline.name());
                return Err(Error::Config(problem));
            }
            baseline.check_test(data, test)?;
        }
        Ok(())
    }

    /// Returns the demands of baselines and metrics.
    fn scoring_demands(&self) -> Vec<Demand> {
        let metrics = self.metrics.iter().map(|metric| metric.demand());
        self.baselines.iter().map(|baseline| baseline.demand()).chain(metrics).collect()
    }

    /// Checks that all plugins fit together, as far as this is known before loading, and that the other settings are valid.
    ///
    /// # Errors
    /// The field of the first problem, and the problem.
    pub(crate) fn check(&self) -> Result<(), (String, String)> {
        let (task, plan) = (self.data.task(), self.unscaled_plan());
        let unused = task.and_then(|task| Some(Misfit::Unused(unused_field(self, task)?, task)));
        let demands = &[vec![self.initializer.demand()], self.scoring_demands()].concat();
        let parts = Parts { task, demands, ..plan.parts(self.initializer.count()) };
        let checked = unused.map_or_else(|| check_compatible(&parts), Err);
        checked.map_err(|misfit| (misfit.field(), misfit.to_string()))?;
        let is_plain = |c: char| c.is_ascii_alphanumeric() || "._-".contains(c);
        if self.name.is_empty() || self.name.starts_with('.') || !self.name.chars().all(is_plain) {
            let name = shortened(&self.name);
            let problem =
                format!("name: `{name}` cannot name a folder; use letters, digits, `-`, `_` and, not first, `.`");
            return Err(("name".into(), problem));
        }
        if !(1..=MOST_MEMBERS).contains(&self.members) {
            let problem = format!("members: {} models; give 1 to {MOST_MEMBERS}, such as 4", self.members);
            return Err(("members".into(), problem));
        }
        self.readout.check().map_err(|problem| ("readout".into(), problem))?;
        if self.method.as_ref().is_some_and(|method| name_of(method) == "Splatting") {
            let problem = "method: `Splatting` is what the fields projector, rasterizer, deformation, calibration and readout \
                        say; leave `method` out";
            return Err(("method".into(), problem.into()));
        }
        Ok(())
    }
}

/// Returns the first field of splats with a value other than its default, although the method without the field `method` does
/// not use it; `None` if there is none, or if `method` is given.
fn unused_field(pipeline: &Pipeline, task: Task) -> Option<&'static str> {
    if pipeline.method.is_some() || pipeline.method().traits().rasterizer.is_some() {
        return None;
    }
    let Pipeline { projector, rasterizer, calibration, readout, .. } = pipeline;
    let is_default = [
        ("projector", to_ron(projector) == to_ron(&defaults::projector())),
        ("rasterizer", to_ron(rasterizer) == to_ron(&defaults::rasterizer())),
        ("calibration", *calibration == Calibration::default()),
        ("readout", *readout == defaults::readout(task)),
    ];
    is_default.into_iter().find(|(_, is_default)| !is_default).map(|(field, _)| field)
}

#[cfg(test)]
mod tests {
    use super::Pipeline;
    use pwrfgs_core::plugin::{ron_options, to_ron};
    use pwrfgs_core::{Baseline, Metric, Plugin};
    use std::path::Path;

    fn parse(fields: &str) -> Result<Pipeline, String> {
        Pipeline::parse(&format!("Pipeline(\n{fields})"), Path::new("a.ron")).map_err(|e| e.to_string())
    }

    #[test]
    fn omitted_fields_use_defaults_of_task() {
        let cases = [
            (
                "Teacher()",
                "[MeanSpectrum(), NearestNeighbours(k: 1), NearestNeighbours(k: 3), NearestNeighbours(k: 5)]",
                "[Ssim(), L1(), Psnr(), RateRatio(), DirectionError(), Chamfer(), GaussianCount(), ModelSize(), Latency()]",
                "Magnitude",
            ),
            (
                "Nerf2Rssi(root: \"x\")",
                "[MeanSpectrum(), LogDistance(), NearestNeighbours(k: 5), Kriging()]",
                "[PowerError(), Chamfer(), GaussianCount(), ModelSize(), Latency()]",
                "ReceivedPower(",
            ),
            (
                "Channels(root: \"x\", carrier_hz: 3e8, spacing_hz: 1e7, receiver: ())",
                "[Zero(), NearestNeighbours(k: 1), NearestNeighbours(k: 5)]",
                "[ChannelSnr(), Chamfer(), GaussianCount(), ModelSize(), Latency()]",
                "",
            ),
        ];
        for (data, baselines, metrics, readout) in cases {
            let pipeline = parse(&format!("name: \"a\", data: {data}, initializer: Random()")).unwrap();
            let baselines: Vec<Plugin<dyn Baseline>> = ron_options().from_str(baselines).unwrap();
            let metrics: Vec<Plugin<dyn Metric>> = ron_options().from_str(metrics).unwrap();
            assert_eq!(to_ron(&pipeline.baselines), to_ron(&baselines), "{data}");
            assert_eq!(to_ron(&pipeline.metrics), to_ron(&metrics), "{data}");
            assert!(to_ron(&pipeline.readout).starts_with(readout), "{data}");
            let parts = (&pipeline.split, &pipeline.projector, &pipeline.rasterizer, &pipeline.deformation);
            let text = to_ron(&parts);
            for name in ["Official(", "Mercator(", "AlphaBlending(", "Mlp("] {
                assert!(text.contains(name), "{data}: {text}");
            }
            let given = parse(&format!("name: \"a\", data: {data}, initializer: Random(), baselines: [], metrics: []"));
            assert!(given.is_ok_and(|pipeline| pipeline.baselines.is_empty() && pipeline.metrics.is_empty()), "{data}");
        }
    }

    #[test]
    fn reports_position_of_missing_and_unsupported_fields() {
        let refused = |fields: &str| parse(fields).unwrap_err();
        assert_eq!(refused("name: \"a\", initializer: Random()"), "a.ron:2:33: the field `data` is missing");
        assert!(refused("name: \"a\", data: Teacher()").ends_with("the field `initializer` is missing"));
        let shown = refused("name: \"a\",\n data: Teacher(),\n initializer: Random(),\n metrics: [PowerError()]");
        assert!(shown.starts_with("a.ron:5:11: metrics: "), "{shown}");
        assert!(refused("name: \"a/b\", data: Teacher(), initializer: Random()").starts_with("a.ron:2:7: name: "));
    }

    #[test]
    fn unknown_entry_of_unnamed_entries_is_reported() {
        let mut pipeline = parse("name: \"a\", data: Teacher(), initializer: Random(), accept: [\"axes\"]").unwrap();
        let message = pipeline.set("accept.x=row-order").unwrap_err().to_string();
        assert!(message.contains("`accept` has no entry `x` (its entries have no names"), "{message}");
    }

    #[test]
    fn plugin_paths_become_absolute() {
        let data = "Channels(root: \"r\", points: \"p.ply\", carrier_hz: 3e8, spacing_hz: 1e7, receiver: ())";
        let relative = parse(&format!("name: \"a\", data: {data}, initializer: Trained(model: \"m\")")).unwrap();
        let absolute = relative.rebased(&|path| Path::new("/base").join(path)).unwrap().to_ron().unwrap();
        for field in ["root: \"/base/r\"", "points: \"/base/p.ply\"", "model: \"/base/m\""] {
            assert!(absolute.contains(field), "{field}: {absolute}");
        }
        assert_eq!(absolute.matches("/base/").count(), 3, "`file` and `positions` start at `root`: {absolute}");
    }

    #[test]
    fn rejects_fields_unsupported_by_channel_method() {
        let channels = |field: &str| {
            let data = "Channels(root: \"x\", carrier_hz: 3e8, spacing_hz: 1e7, receiver: ())";
            parse(&format!("name: \"a\", data: {data}, initializer: Random(),\n{field}"))
        };
        for field in
            ["projector: Mercator(blur: 1)", "rasterizer: ArrayResponse()", "calibration: AsReleased", "readout: Real"]
        {
            let (name, message) = (field.split(':').next().unwrap(), channels(field).unwrap_err());
            assert!(
                message.starts_with("a.ron:3:") && message.contains(&format!("{name}: the method of channels")),
                "{message}"
            );
        }
        let written = channels("").unwrap().to_ron().unwrap();
        assert_eq!(Pipeline::parse(&written, Path::new("a.ron")).unwrap().to_ron().unwrap(), written);
    }
}
