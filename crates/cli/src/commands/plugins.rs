//! `pwrfgs plugins`: lists and describes plugins and settings, in the notation of a pipeline.

use crate::output;
use crate::reference::commented::{CommentStyle, describe_type};
use crate::reference::{DocChapter, DocItem, list_chapters, markdown, prose};
use clap::Args;
use pwrfgs::experiment::sweep::Experiment;
use pwrfgs::experiment::text::wrap_words;
use pwrfgs::prelude::Pipeline;
use pwrfgs_core::docs::{DocBody, Docs};
use pwrfgs_core::schemars::{self, JsonSchema, schema_for};
use pwrfgs_core::{Error, Result, did_you_mean};
use serde_json::Value;
use std::fmt::Write as _;

#[derive(Debug, Args)]
#[command(after_help = "\
Without NAME, the command lists all names. For a kind (Pruner, or its field pruners), it lists the
plugins. For a plugin (LearnableMask), settings (training, optimizer, loss), a type (Schedule),
Pipeline or Experiment, it prints each field with default, type and description.

EXAMPLES
  pwrfgs plugins
  pwrfgs plugins pruners
  pwrfgs plugins LearnableMask
  pwrfgs plugins --markdown > docs/reference.md
  pwrfgs plugins --schema > pwrfgs.schema.json")]
pub(crate) struct Plugins {
    /// Kind, plugin, settings or type [default: list all names]
    #[arg(value_name = "NAME")]
    pub(crate) name: Option<String>,
    /// Print the complete reference as Markdown
    #[arg(long, conflicts_with = "name")]
    pub(crate) markdown: bool,
    /// Print the JSON schema of pipeline and experiment files
    #[arg(long, conflicts_with_all = ["name", "markdown"])]
    pub(crate) schema: bool,
}

/// Characters per line.
const WIDTH: usize = 110;
/// Characters per line of the list of all names.
const NARROW: usize = 100;

/// Runs `pwrfgs plugins`: prints the list of names, one entry, or the whole reference.
pub(crate) fn print_reference(arguments: &Plugins) -> Result<()> {
    let chapters = list_chapters();
    let text = match &arguments.name {
        _ if arguments.schema => file_schema(),
        _ if arguments.markdown => markdown::format_reference(&chapters),
        None => list_names(&chapters),
        Some(name) => describe_entries(name, &chapters)?,
    };
    output::print_result(&text)
}

/// Lists the names of all kinds, each with its plugins, settings and types.
fn list_names(chapters: &[DocChapter]) -> String {
    let heads: Vec<String> = chapters
        .iter()
        .map(|chapter| {
            chapter.field.map_or_else(|| chapter.name.clone(), |field| format!("{} ({field})", chapter.name))
        })
        .collect();
    let column = heads.iter().map(|head| head.chars().count() + 2).max().unwrap_or(0);
    let mut out = format!("{:column$}{}\n", "kind (field)", "plugins; settings and types");
    for (chapter, head) in chapters.iter().zip(&heads) {
        let is_type = |topic: &&DocItem| chapter.field.is_some() && !topic.fields.is_empty();
        let names = |types: bool| {
            let topics = chapter.topics.iter().filter(|topic| is_type(topic) == types);
            topics.map(|topic| topic.name.as_str()).collect::<Vec<_>>().join(", ")
        };
        let parts: Vec<String> = [names(false), names(true)].into_iter().filter(|names| !names.is_empty()).collect();
        out += &wrap_words(&parts.join("; "), [&format!("{head:column$}"), &" ".repeat(column)], NARROW);
    }
    out + "\npwrfgs plugins KIND lists a kind; pwrfgs plugins NAME shows fields, defaults and descriptions;\n\
           pwrfgs plugins --markdown prints the complete reference\n"
}

/// Lists the kinds and describes the plugins, settings and types that are called `name`, ignoring case. Returns an error if
/// there are none.
fn describe_entries(name: &str, chapters: &[DocChapter]) -> Result<String> {
    let requested = name.to_lowercase();
    let mut out = String::new();
    for chapter in chapters {
        let topics = || chapter.topics.iter().filter(|topic| topic.is_called(&requested));
        let is_kind = chapter.is_called(&requested);
        if is_kind || topics().next().is_some() {
            let field = chapter.field.map_or_else(String::new, |field| format!(" (field `{field}`)"));
            _ = writeln!(out, "{}{field}: {}", chapter.name, chapter.about);
        }
        topics().for_each(|topic| write_topic(&mut out, topic));
        let others = chapter.topics.iter().filter(|topic| is_kind && !topic.is_called(&requested));
        others.for_each(|topic| write_summary(&mut out, topic));
    }
    if out.is_empty() { Err(unknown_name_error(name, chapters)) } else { Ok(out) }
}

/// Adds the name of a topic and the first sentence of its comment to `out`.
fn write_summary(out: &mut String, topic: &DocItem) {
    let summary = topic.docs.map_or_else(String::new, |docs| prose::first_sentence(docs.text));
    let colon = if summary.is_empty() { "" } else { ": " };
    out.push_str(&wrap_words(&format!("{}{colon}{summary}", markdown::topic_title(topic)), ["  ", "      "], WIDTH));
}

/// Adds a topic with its whole comment and all of its fields or variants to `out`.
fn write_topic(out: &mut String, topic: &DocItem) {
    _ = writeln!(out, "  {}", markdown::topic_title(topic));
    for paragraph in topic.docs.map_or_else(Vec::new, |docs| prose::split_paragraphs(docs.text)) {
        out.push_str(&wrap_words(&paragraph, ["      "; 2], WIDTH));
    }
    match (topic.docs, &topic.value) {
        (Some(Docs { body: DocBody::Variants(variants), .. }), _) => {
            for variant in *variants {
                let words = format!("{}: {}", markdown::variant_notation(variant), markdown::variant_text(variant));
                out.push_str(&wrap_words(&words, ["      "; 2], WIDTH));
            }
        }
        (docs, Ok(value)) => {
            let text = CommentStyle::FLAT.write(value, docs, "      ");
            _ = writeln!(out, "      {text}");
        }
        (Some(docs), Err(_)) => {
            for field in docs.fields() {
                let words =
                    format!("{}: {} [{}]", field.name, prose::single_line(field.text), describe_type(&field.kind));
                out.push_str(&wrap_words(&words, ["      "; 2], WIDTH));
            }
        }
        (None, Err(why)) => _ = writeln!(out, "      (no defaults: {why})"),
    }
}

/// Creates the error for an unknown name, with the nearest one.
fn unknown_name_error(name: &str, chapters: &[DocChapter]) -> Error {
    let names = chapters.iter().flat_map(|c| {
        let topics = c.topics.iter().flat_map(|t| t.fields.iter().copied().chain([t.name.as_str()]));
        topics.chain(c.field).chain([c.name.as_str()])
    });
    let hint = did_you_mean(name, names);
    let name: String = name.chars().filter(|c| !c.is_control()).take(100).collect();
    Error::Config(format!("unknown plugin, kind or setting `{name}`{hint} (`pwrfgs plugins` lists all)"))
}

/// A pipeline or experiment file: `Name(field: value)` in RON is `{"Name": {"field": value}}` here.
#[derive(JsonSchema)]
#[expect(dead_code, reason = "only its schema is used")]
enum File {
    /// Pipeline of one run, as `pwrfgs run` reads it.
    Pipeline(Box<Pipeline>),
    /// Experiment of many runs, as `pwrfgs sweep` reads it.
    Experiment(Box<Experiment>),
}

/// Creates the JSON schema of pipeline and experiment files, for editors and programs.
fn file_schema() -> String {
    let mut schema = schema_for!(File).to_value();
    shorten_numbers(&mut schema);
    format!("{schema:#}\n")
}

/// Replaces, inside `value`, the numbers that are exact in single precision by their shortest decimals of that
/// precision.
fn shorten_numbers(value: &mut Value) {
    match value {
        Value::Number(number) if number.is_f64() => {
            let exact = number.as_f64().unwrap_or_default();
            let short = (exact as f32).to_string().parse::<f64>();
            if let (true, Ok(short)) = (f64::from(exact as f32) == exact, short) {
                *value = short.into();
            }
        }
        Value::Array(items) => items.iter_mut().for_each(shorten_numbers),
        Value::Object(fields) => fields.values_mut().for_each(shorten_numbers),
        _ => {}
    }
}
