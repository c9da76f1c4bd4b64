//! Values as RON, with a comment above each field: its description and type.

use super::prose;
use pwrfgs::experiment::text::wrapped;
use pwrfgs::pipeline::ron_tree::{RonBody, RonTree};
use pwrfgs_core::docs::{DocBody as Shape, DocField, DocKind, Docs};
use pwrfgs_core::plugin::PluginFamily;
use std::fmt::Write as _;

/// Characters per line.
const WIDTH: usize = 110;

/// Value with its RON text.
#[derive(Clone)]
pub(crate) struct Value {
    pub(super) text: String,
    tree: RonTree,
}

impl Value {
    /// Parses `text`, which a serialiser or parser has accepted.
    pub(crate) fn new(text: String) -> Result<Self, String> {
        Ok(Self { tree: RonTree::parse(&text)?, text })
    }

    /// Returns the RON text of the value at `path`.
    pub(crate) fn at(&self, path: &[&str]) -> Option<&str> {
        let inside = path.iter().try_fold(&self.tree, |tree, field| tree.field(field));
        inside.map(|tree| tree.text_in(&self.text))
    }

    /// Returns the RON text of a field, in one line.
    pub(super) fn field(&self, field: &DocField) -> Option<String> {
        self.tree.field(field.name).map(|tree| short_text(Some(&field.kind), tree, &self.text))
    }

    /// Returns the value of a field.
    pub(super) fn part(&self, name: &str) -> Option<Self> {
        Self::new(self.tree.field(name)?.text_in(&self.text).to_owned()).ok()
    }
}

/// Layout of a written value.
pub(crate) struct CommentStyle<'a> {
    /// Whether a field, by name, is expanded to one line per inner field.
    pub(crate) opens: &'a dyn Fn(&str) -> bool,
    /// Whether a field is shown, by the names of value and field.
    pub(crate) shows: &'a dyn Fn(&str, &str) -> bool,
}

impl CommentStyle<'_> {
    /// All fields, nested values in one line.
    pub(crate) const FLAT: Self = CommentStyle { opens: &|_| false, shows: &|_, _| true };

    /// Writes the value with the comments of `docs`. Each line starts with `indent`, except the first.
    pub(crate) fn write(&self, value: &Value, docs: Option<&'static Docs>, indent: &str) -> String {
        let mut out = String::new();
        self.write_tree(&value.tree, &value.text, docs, indent, &mut out);
        out
    }

    /// Writes a tree of `text`; values that open get one line per inner field.
    fn write_tree(&self, tree: &RonTree, text: &str, docs: Option<&'static Docs>, indent: &str, out: &mut String) {
        let RonBody::Fields(fields) = &tree.body else {
            out.push_str(&compact_text(tree, text));
            return;
        };
        _ = writeln!(out, "{}(", tree.name.as_deref().unwrap_or_default());
        let inside = format!("{indent}    ");
        let owner = tree.name.as_deref().unwrap_or_default();
        for (name, value) in fields.iter().filter(|(name, _)| (self.shows)(owner, name)) {
            let field = docs.and_then(|d| d.field(tree.name.as_deref(), name));
            if let Some(field) = field {
                out.push_str(&field_comment(field, &inside));
            }
            _ = write!(out, "{inside}{name}: ");
            let kind = field.map(|f| &f.kind);
            match (&value.body, (self.opens)(name)) {
                (RonBody::Fields(_), true) => self.write_tree(value, text, docs_at(kind, value), &inside, out),
                (RonBody::Items(items), true) if !items.is_empty() && value.text_in(text).starts_with('[') => {
                    out.push_str("[\n");
                    for item in items {
                        let deeper = format!("{inside}    ");
                        out.push_str(&deeper);
                        self.write_tree(item, text, docs_at(kind, item), &deeper, out);
                        out.push_str(",\n");
                    }
                    _ = write!(out, "{inside}]");
                }
                _ => out.push_str(&short_text(kind, value, text)),
            }
            out.push_str(",\n");
        }
        _ = write!(out, "{indent})");
    }
}

/// Formats the comment of a field, with its type.
fn field_comment(field: &DocField, indent: &str) -> String {
    let words = format!("{} [{}]", prose::line(field.text), takes(&field.kind));
    wrapped(&words, [&format!("{indent}// "); 2], WIDTH)
}

/// Returns the comments on a value of this kind.
fn docs_at(kind: Option<&DocKind>, value: &RonTree) -> Option<&'static Docs> {
    match kind? {
        DocKind::Of(docs) => Some(docs),
        DocKind::Plugin(kind) => {
            let members = (PluginFamily::find(kind)?.members)();
            members.iter().find(|m| Some(m.name) == value.name.as_deref())?.docs
        }
        DocKind::Optional(inner) | DocKind::List(inner) => docs_at(Some(inner), value),
        _ => None,
    }
}

/// Writes a value in one line; settings whose fields are all optional become `Name()`.
fn short_text(kind: Option<&DocKind>, tree: &RonTree, text: &str) -> String {
    match kind {
        Some(DocKind::Of(docs)) if !docs.fields().is_empty() && docs.fields().iter().all(|f| f.optional) => {
            format!("{}()", docs.name)
        }
        _ => compact_text(tree, text),
    }
}

/// Writes a value in one line, with all fields.
fn compact_text(tree: &RonTree, text: &str) -> String {
    let name = tree.name.as_deref().unwrap_or_default();
    let list = |items: &[RonTree]| items.iter().map(|item| compact_text(item, text)).collect::<Vec<_>>().join(", ");
    match &tree.body {
        RonBody::Plain => tree.text_in(text).to_owned(),
        RonBody::Fields(fields) => {
            let fields: Vec<String> =
                fields.iter().map(|(n, value)| format!("{n}: {}", compact_text(value, text))).collect();
            format!("{name}({})", fields.join(", "))
        }
        RonBody::Items(items) if tree.text_in(text).starts_with('[') => format!("[{}]", list(items)),
        RonBody::Items(items) => format!("{name}({})", list(items)),
    }
}

/// Describes the type of a field in words; the variants of an enum.
pub(crate) fn takes(kind: &DocKind) -> String {
    match kind {
        DocKind::Of(Docs { name, body: Shape::Variants(variants), .. }) => {
            let names: Vec<&str> = variants.iter().map(|v| v.name).collect();
            format!("{name}: {}", names.join(", "))
        }
        DocKind::Optional(inner) => format!("{} or None", takes(inner)),
        other => other.words(),
    }
}
