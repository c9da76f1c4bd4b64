//! Plugins, settings and types of pipelines and experiments, from comments and defaults in the source. `pwrfgs plugins`
//! prints them; `pwrfgs init` writes them as comments.

pub(crate) mod commented;
pub(crate) mod markdown;
pub(crate) mod prose;

use commented::Value;
use pwrfgs::prelude::Pipeline;
use pwrfgs_core::docs::{DocBody, DocField, DocKind, Docs};
use pwrfgs_core::plugin::{PluginFamily, to_ron};
use std::path::Path;

/// Stands for the experiment file, which no field holds.
const EXPERIMENT: &str = "experiment";

/// Topics under one heading.
pub(crate) struct DocChapter {
    /// Heading, such as `Pruner`.
    pub(crate) name: String,
    /// Field of the pipeline that holds such plugins.
    pub(crate) field: Option<&'static str>,
    /// Purpose, one sentence.
    pub(crate) about: String,
    pub(crate) topics: Vec<DocItem>,
}

/// A struct, an enum or a plugin.
pub(crate) struct DocItem {
    pub(crate) name: String,
    /// Fields of this type: `loss` for `Loss`.
    pub(crate) fields: Vec<&'static str>,
    pub(crate) docs: Option<&'static Docs>,
    /// Value with all defaults, or the reason why there is none.
    pub(crate) value: Result<Value, String>,
}

/// Lists all chapters of the reference: pipeline, settings, plugin kinds in the order of their fields, and experiment.
pub(crate) fn list_chapters() -> Vec<DocChapter> {
    let pipeline = example_pipeline();
    let mut settings = Vec::new();
    let mut plugins = Vec::new();
    for field in Docs::of::<Pipeline>().fields() {
        match inner_kind(&field.kind) {
            DocKind::Plugin(kind) => {
                plugins.extend(PluginFamily::find(kind).map(|family| plugin_chapter(family, field)));
            }
            DocKind::Of(docs) => {
                let value = pipeline.as_ref().ok().and_then(|p| p.field_value(field.name));
                collect_type(docs, field.name, value.as_ref(), &mut settings);
            }
            _ => {}
        }
    }
    let docs = Some(Docs::of::<Pipeline>());
    let whole = DocChapter {
        name: "Pipeline".into(),
        field: None,
        about: "Settings of one run, as `pwrfgs run` reads them.".into(),
        topics: vec![DocItem { name: "Pipeline".into(), fields: Vec::new(), docs, value: pipeline }],
    };
    let settings = DocChapter {
        name: "Settings".into(),
        field: None,
        about: "Settings of a pipeline that are not plugins.".into(),
        topics: settings,
    };
    let mut chapters = vec![whole, settings];
    chapters.extend(plugins);
    chapters.push(experiment_chapter());
    chapters
}

/// Creates the value of a pipeline with only the required fields; the error states why it is invalid.
pub(crate) fn example_pipeline() -> Result<Value, String> {
    let required = Pipeline::REQUIRED.map(|(field, value)| format!("{field}: {value}")).join(", ");
    let pipeline =
        Pipeline::parse(&format!("Pipeline({required})"), Path::new("example")).map_err(|e| e.to_string())?;
    Value::new(to_ron(&pipeline))
}

/// Creates the chapter of the plugins of `family`, which `field` of a pipeline holds, with the types of their fields.
fn plugin_chapter(family: &'static PluginFamily, field: &'static DocField) -> DocChapter {
    let mut topics = Vec::new();
    let mut types = Vec::new();
    for member in (family.members)() {
        let value = member.text.and_then(Value::new);
        if let Some(docs) = member.docs {
            collect_fields(docs.fields(), value.as_ref().ok(), &mut types);
        }
        topics.push(DocItem { name: member.name.into(), fields: Vec::new(), docs: member.docs, value });
    }
    topics.extend(types);
    DocChapter { name: family.kind.into(), field: Some(field.name), about: prose::single_line(field.text), topics }
}

/// Creates the chapter of the experiment file.
fn experiment_chapter() -> DocChapter {
    use pwrfgs::experiment::sweep::{Experiment, Slurm};
    let mut topics = Vec::new();
    collect_type(Docs::of::<Experiment>(), EXPERIMENT, None, &mut topics);
    if let Some(slurm) = topics.iter_mut().find(|topic| topic.name == "Slurm") {
        slurm.value = Value::new(to_ron(&Slurm::default()));
    }
    let about = "Settings of a sweep, as `pwrfgs sweep` reads them.".into();
    DocChapter { name: "Experiment".into(), field: None, about, topics }
}

/// Adds the type of `field` and, recursively, the types of its fields to `topics`, each once; `value` holds its
/// defaults.
fn collect_type(docs: &'static Docs, field: &'static str, value: Option<&Value>, topics: &mut Vec<DocItem>) {
    if let Some(topic) = topics.iter_mut().find(|t| t.docs.is_some_and(|d| d.name == docs.name)) {
        if !topic.fields.contains(&field) {
            topic.fields.push(field);
        }
        return;
    }
    topics.push(DocItem {
        name: docs.name.into(),
        fields: if field == EXPERIMENT { Vec::new() } else { vec![field] },
        docs: Some(docs),
        value: value.cloned().ok_or_else(|| "a required field has no default".into()),
    });
    match docs.body {
        DocBody::Fields(fields) => collect_fields(fields, value, topics),
        DocBody::Variants(variants) => variants.iter().for_each(|v| collect_fields(v.fields, None, topics)),
    }
}

/// Adds the types of `fields` and, recursively, of their fields to `topics`; `value` holds the defaults of all fields.
fn collect_fields(fields: &'static [DocField], value: Option<&Value>, topics: &mut Vec<DocItem>) {
    for field in fields {
        if let DocKind::Of(docs) = inner_kind(&field.kind) {
            let inner = value.and_then(|v| v.field_value(field.name));
            collect_type(docs, field.name, inner.as_ref(), topics);
        }
    }
}

/// Returns the kind inside options, lists and maps.
fn inner_kind(kind: &DocKind) -> DocKind {
    match kind {
        DocKind::Optional(kind) | DocKind::List(kind) | DocKind::Map(kind) => inner_kind(kind),
        other => other.clone(),
    }
}

impl DocChapter {
    /// Returns whether `name`, in lower case, is that of the chapter or of its field.
    pub(crate) fn is_called(&self, name: &str) -> bool {
        self.name.to_lowercase() == name || self.field.is_some_and(|field| field == name)
    }
}

impl DocItem {
    /// Returns whether `name`, in lower case, is that of the topic or of one of its fields.
    pub(crate) fn is_called(&self, name: &str) -> bool {
        self.name.to_lowercase() == name || self.fields.contains(&name)
    }
}
