//! `pwrfgs plugins`: everything that a pipeline may name, written as a pipeline would have it.

use crate::output;
use crate::reference::commented::{Style, takes};
use crate::reference::{Chapter, Topic, chapters, markdown, prose};
use clap::Args;
use pwrfgs::experiment::sweep::Experiment;
use pwrfgs::experiment::text::wrapped;
use pwrfgs::prelude::Pipeline;
use pwrfgs_core::docs::{Body, Docs};
use pwrfgs_core::schemars::{self, JsonSchema, schema_for};
use pwrfgs_core::{Error, Result, did_you_mean};
use serde_json::Value;
use std::fmt::Write as _;

#[derive(Debug, Args)]
#[command(
    after_long_help = "NAME is a plugin (LearnableMask), all of a kind (Pruner, or its field pruners), settings \
    (training, optimizer, densify, loss), a type (Readout, Schedule), or Pipeline and Experiment for their own fields. Every \
    field is shown with its default, what it takes and what it does; these are the comments of the source.\n\nEXAMPLES\n  pwrfgs plugins LearnableMask\n  pwrfgs plugins training\n  pwrfgs plugins \
    readout\n  pwrfgs plugins --schema > pwrfgs.schema.json"
)]
pub(crate) struct Plugins {
    /// Only this: a plugin, a kind of plugins, settings or a type
    #[arg(value_name = "NAME")]
    pub(crate) name: Option<String>,
    /// Everything as one page of Markdown
    #[arg(long, conflicts_with = "name")]
    pub(crate) markdown: bool,
    /// Print the JSON schema of pipeline and experiment files
    #[arg(long, conflicts_with_all = ["name", "markdown"])]
    pub(crate) schema: bool,
}

/// Signs a line.
const WIDTH: usize = 110;

pub(crate) fn plugins(arguments: &Plugins) -> Result<()> {
    if arguments.markdown || arguments.schema {
        return output::result(&if arguments.schema { schema() } else { markdown::page(&chapters()) });
    }
    let chapters = chapters();
    let wanted = arguments.name.as_deref().map(str::to_lowercase);
    let mut out = String::new();
    for chapter in &chapters {
        let whole = wanted.as_deref().is_none_or(|w| chapter.is_called(w));
        let chosen = |t: &&Topic| whole || wanted.as_deref().is_some_and(|w| t.is_called(w));
        let mut topics = chapter.topics.iter().filter(chosen).peekable();
        if topics.peek().is_some() {
            let field = chapter.field.map_or_else(String::new, |field| format!(" (field `{field}`)"));
            _ = writeln!(out, "{}{field}: {}", chapter.name, chapter.about);
        }
        topics.for_each(|topic| write_topic(&mut out, topic, !whole));
    }
    if out.is_empty() {
        return Err(unknown(arguments.name.as_deref().unwrap_or_default(), &chapters));
    }
    output::result(&out)
}

/// A topic; `full` with all of its comment.
fn write_topic(out: &mut String, topic: &Topic, full: bool) {
    let paragraphs = topic.docs.map_or_else(Vec::new, |docs| prose::paragraphs(docs.text));
    let about =
        if full { String::new() } else { topic.docs.map_or_else(String::new, |docs| prose::summary(docs.text)) };
    _ = writeln!(out, "  {}{}{about}", markdown::title(topic), if about.is_empty() { "" } else { ": " });
    if full {
        for paragraph in &paragraphs {
            out.push_str(&wrapped(paragraph, ["      "; 2], WIDTH));
        }
    }
    match (topic.docs, &topic.value) {
        (Some(Docs { body: Body::Variants(variants), .. }), _) => {
            for variant in *variants {
                let words = format!("{}: {}", markdown::form(variant), markdown::meaning(variant));
                out.push_str(&wrapped(&words, ["      "; 2], WIDTH));
            }
        }
        (docs, Ok(value)) => {
            let text = Style::FLAT.write(value, docs, "      ");
            _ = writeln!(out, "      {text}");
        }
        (Some(docs), Err(_)) => {
            for field in docs.fields() {
                let words = format!("{}: {} [{}]", field.name, prose::line(field.text), takes(&field.kind));
                out.push_str(&wrapped(&words, ["      "; 2], WIDTH));
            }
        }
        (None, Err(why)) => _ = writeln!(out, "      (not without fields: {why})"),
    }
}

/// No such name; the nearest helps.
fn unknown(name: &str, chapters: &[Chapter]) -> Error {
    let names = chapters.iter().flat_map(|c| {
        let topics = c.topics.iter().flat_map(|t| t.fields.iter().copied().chain([t.name.as_str()]));
        topics.chain(c.field).chain([c.name.as_str()])
    });
    let hint = did_you_mean(name, names);
    let name: String = name.chars().filter(|c| !c.is_control()).take(100).collect();
    Error::Config(format!("nothing that a pipeline may name is called `{name}`{hint} (`pwrfgs plugins` lists all)"))
}

/// A file of pwrfgs: `Name(field: value)` in RON is `{"Name": {"field": value}}` here.
#[derive(JsonSchema)]
#[expect(dead_code, reason = "its schema alone is of use")]
enum File {
    /// A run, as `pwrfgs run` reads it.
    Pipeline(Box<Pipeline>),
    /// A sweep, as `pwrfgs sweep` reads it.
    Experiment(Box<Experiment>),
}

/// The JSON schema of pipeline and experiment files, for editors and programs that write such files.
fn schema() -> String {
    let mut schema = schema_for!(File).to_value();
    shorten(&mut schema);
    format!("{schema:#}\n")
}

/// Writes defaults in single precision with the digits of single precision.
fn shorten(value: &mut Value) {
    match value {
        Value::Number(number) if number.is_f64() => {
            let exact = number.as_f64().unwrap_or_default();
            let short = (exact as f32).to_string().parse::<f64>();
            if let (true, Ok(short)) = (f64::from(exact as f32) == exact, short) {
                *value = short.into();
            }
        }
        Value::Array(items) => items.iter_mut().for_each(shorten),
        Value::Object(fields) => fields.values_mut().for_each(shorten),
        _ => {}
    }
}
