//! The reference as one page of Markdown.

use super::commented::{Value, describe_type};
use super::{DocChapter, DocItem, prose};
use pwrfgs::prelude::Pipeline;
use pwrfgs_core::docs::{DocBody, DocField, DocVariant, Docs};
use std::fmt::Write as _;

/// Formats the complete reference as a page: list of contents, then all chapters.
pub(crate) fn format_reference(chapters: &[DocChapter]) -> String {
    let mut out = String::from(
        "# Reference\n\nThis page lists all plugins, settings and types of pipelines and experiments, with defaults.\n`pwrfgs \
         plugins --markdown` generates it from the comments in the source; `pwrfgs plugins NAME` prints one entry.\n\n",
    );
    for chapter in chapters {
        let topics: Vec<String> = chapter.topics.iter().map(|t| format!("`{}`", t.name)).collect();
        let field = chapter.field.map_or_else(String::new, |field| format!(" (`{field}`)"));
        _ = writeln!(out, "- **{}**{field}: {}", chapter.name, topics.join(", "));
    }
    for chapter in chapters {
        let field = chapter.field.map_or_else(String::new, |field| format!(": field `{field}`"));
        _ = writeln!(out, "\n## {}{field}\n\n{}", chapter.name, prose::break_sentences(&chapter.about));
        chapter.topics.iter().for_each(|topic| write_topic(&mut out, chapter, topic));
    }
    out
}

/// Adds the section of a topic to `out`, with a table of its fields or variants.
fn write_topic(out: &mut String, chapter: &DocChapter, topic: &DocItem) {
    if chapter.name != topic.name {
        _ = writeln!(out, "\n### {}", topic_title(topic));
    }
    let Some(docs) = topic.docs else {
        match &topic.value {
            Ok(value) => _ = writeln!(out, "\n```ron\n{}\n```", value.text),
            Err(why) => _ = writeln!(out, "\nNo defaults: {why}"),
        }
        return;
    };
    let mut is_in_table = false;
    for paragraph in prose::split_paragraphs(docs.text) {
        let is_row = paragraph.starts_with('|');
        _ = writeln!(
            out,
            "{}{}",
            if is_row && is_in_table { "" } else { "\n" },
            if is_row { paragraph.clone() } else { prose::break_sentences(&paragraph) }
        );
        is_in_table = is_row;
    }
    write_table(out, docs, topic.value.as_ref().ok());
}

/// Formats the name of a topic, with the fields of this type.
pub(crate) fn topic_title(topic: &DocItem) -> String {
    match &topic.fields[..] {
        [] => topic.name.clone(),
        [field] => format!("{} (field `{field}`)", topic.name),
        fields => format!("{} (fields `{}`)", topic.name, fields.join("`, `")),
    }
}

/// Adds the table of fields or variants to `out`; `value` holds the defaults.
fn write_table(out: &mut String, docs: &Docs, value: Option<&Value>) {
    match docs.body {
        DocBody::Fields([]) => _ = writeln!(out, "\nNo fields."),
        DocBody::Fields(fields) => {
            _ = writeln!(out, "\n| field | type | default | description |\n|---|---|---|---|");
            for field in fields {
                let default =
                    if docs.name == "Pipeline" && Pipeline::REQUIRED.iter().any(|(name, _)| *name == field.name) {
                        "required".into()
                    } else {
                        default_text(field, value)
                    };
                write_row(
                    out,
                    &[
                        &format!("`{}`", field.name),
                        &describe_type(&field.kind),
                        &default,
                        &prose::single_line(field.text),
                    ],
                );
            }
        }
        DocBody::Variants(variants) => {
            _ = writeln!(out, "\n| variant | description |\n|---|---|");
            for variant in variants {
                write_row(out, &[&format!("`{}`", variant_notation(variant)), &variant_text(variant)]);
            }
        }
    }
}

/// Formats the default of a field, its text in `value`; `optional` or `required` without one.
fn default_text(field: &DocField, value: Option<&Value>) -> String {
    match value.and_then(|v| v.field_text(field)) {
        Some(text) => format!("`{text}`"),
        None if field.optional => "optional".into(),
        None => "required".into(),
    }
}

/// Formats the notation of a variant: `LogLinear(first: number, last: number, steps: whole number)`.
pub(crate) fn variant_notation(variant: &DocVariant) -> String {
    let field = |f: &DocField| {
        let words = f.kind.words();
        if variant.named { format!("{}: {words}", f.name) } else { words }
    };
    let fields: Vec<String> = variant.fields.iter().map(field).collect();
    if fields.is_empty() { variant.name.into() } else { format!("{}({})", variant.name, fields.join(", ")) }
}

/// Joins the comments of a variant and of its fields.
pub(crate) fn variant_text(variant: &DocVariant) -> String {
    let field = |f: &DocField| {
        let optional = if f.optional { " (optional)" } else { "" };
        format!(" `{}`{optional}: {}", f.name, prose::single_line(f.text))
    };
    let fields: String = variant.fields.iter().filter(|_| variant.named).map(field).collect();
    prose::single_line(variant.text) + &fields
}

/// Adds the row of a table to `out`; bars in cells are escaped.
fn write_row(out: &mut String, cells: &[&str]) {
    let cells: Vec<String> = cells.iter().map(|cell| cell.replace('|', "\\|")).collect();
    _ = writeln!(out, "| {} |", cells.join(" | "));
}
