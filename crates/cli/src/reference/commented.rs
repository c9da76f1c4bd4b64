//! Values as RON, with a comment above each field: its description and type.

use super::prose;
use pwrfgs::experiment::text::wrap_words;
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
    /// Parses RON; the error states the problem without its position.
    pub(crate) fn new(text: String) -> Result<Self, String> {
        Ok(Self { tree: RonTree::parse(&text)?, text })
    }

    /// Returns the RON text of the value at `path`, names of nested fields; `None` if one of them is missing.
    pub(crate) fn text_at(&self, path: &[&str]) -> Option<&str> {
        let inside = path.iter().try_fold(&self.tree, |tree, field| tree.field(field));
        inside.map(|tree| tree.text_in(&self.text))
    }

    /// Returns the RON text of a field, in one line; `None` if it is missing.
    pub(super) fn field_text(&self, field: &DocField) -> Option<String> {
        self.tree.field(field.name).map(|tree| short_text(Some(&field.kind), tree, &self.text))
    }

    /// Returns the value of the field `name`; `None` if it is missing.
    pub(super) fn field_value(&self, name: &str) -> Option<Self> {
        Self::new(self.tree.field(name)?.text_in(&self.text).to_owned()).ok()
    }
}

/// Layout of a written value.
pub(crate) struct CommentStyle<'a> {
    /// Whether a field, by name, is expanded to one line per inner field.
    pub(crate) opens: &'a dyn Fn(&str) -> bool,
    /// Whether a field is shown, by the names of value and field.
    pub(crate) shows: &'a dyn Fn(&str, &str) -> bool,
    /// Fields that are written before the others of their value, by the names of value and field; a line with words
    /// follows the last of them.
    pub(crate) first: (&'a [[&'a str; 2]], &'a str),
}

impl CommentStyle<'_> {
    /// All fields, nested values in one line.
    pub(crate) const FLAT: Self = CommentStyle { opens: &|_| false, shows: &|_, _| true, first: (&[], "") };

    /// Formats the value as RON, with the comments of `docs`. Each line starts with `indent`, except the first.
    pub(crate) fn write(&self, value: &Value, docs: Option<&'static Docs>, indent: &str) -> String {
        let mut out = String::new();
        self.write_tree(&value.tree, &value.text, docs, indent, &mut out);
        out
    }

    /// Adds a tree of `text` to `out`; values that open get one line per inner field.
    fn write_tree(&self, tree: &RonTree, text: &str, docs: Option<&'static Docs>, indent: &str, out: &mut String) {
        let RonBody::Fields(fields) = &tree.body else {
            out.push_str(&compact_text(tree, text));
            return;
        };
        let owner = tree.name.as_deref().unwrap_or_default();
        _ = writeln!(out, "{owner}(");
        let inside = format!("{indent}    ");
        let (first, words) = self.first;
        let rank = |name: &str| first.iter().position(|at| *at == [owner, name]).unwrap_or(first.len());
        let mut shown: Vec<_> = fields.iter().filter(|(name, _)| (self.shows)(owner, name)).collect();
        shown.sort_by_key(|(name, _)| rank(name));
        for (name, value) in shown {
            let field = docs.and_then(|d| d.field(tree.name.as_deref(), name));
            if let Some(field) = field {
                out.push_str(&field_comment(field, &inside));
            }
            _ = write!(out, "{inside}{name}: ");
            let kind = field.map(|f| &f.kind);
            match (&value.body, (self.opens)(name)) {
                (RonBody::Fields(_), true) => self.write_tree(value, text, docs_of_value(kind, value), &inside, out),
                (RonBody::Items(items), true) if !items.is_empty() && value.text_in(text).starts_with('[') => {
                    out.push_str("[\n");
                    for item in items {
                        let deeper = format!("{inside}    ");
                        out.push_str(&deeper);
                        self.write_tree(item, text, docs_of_value(kind, item), &deeper, out);
                        out.push_str(",\n");
                    }
                    _ = write!(out, "{inside}]");
                }
                _ => out.push_str(&short_text(kind, value, text)),
            }
            out.push_str(",\n");
            if rank(name) + 1 == first.len() {
                _ = writeln!(out, "\n{inside}// {}\n{inside}// {words}\n", "-".repeat(WIDTH - inside.len() - 3));
            }
        }
        _ = write!(out, "{indent})");
    }
}

/// Formats the comment of a field, with its type.
fn field_comment(field: &DocField, indent: &str) -> String {
    let words = format!("{} [{}]", prose::single_line(field.text), describe_type(&field.kind));
    wrap_words(&words, [&format!("{indent}// "); 2], WIDTH)
}

/// Returns the comments on a value of this kind; a plugin has those of its name. `None` without comments.
fn docs_of_value(kind: Option<&DocKind>, value: &RonTree) -> Option<&'static Docs> {
    match kind? {
        DocKind::Of(docs) => Some(docs),
        DocKind::Plugin(kind) => {
            let members = (PluginFamily::find(kind)?.members)();
            members.iter().find(|m| Some(m.name) == value.name.as_deref())?.docs
        }
        DocKind::Optional(inner) | DocKind::List(inner) => docs_of_value(Some(inner), value),
        _ => None,
    }
}

/// Formats a value in one line; settings whose fields are all optional become `Name()`, whatever their values.
fn short_text(kind: Option<&DocKind>, tree: &RonTree, text: &str) -> String {
    match kind {
        Some(DocKind::Of(docs)) if !docs.fields().is_empty() && docs.fields().iter().all(|f| f.optional) => {
            format!("{}()", docs.name)
        }
        _ => compact_text(tree, text),
    }
}

/// Formats a value in one line, with all fields.
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

/// Describes the type of a field: name and variants of an enum, words for other types.
pub(crate) fn describe_type(kind: &DocKind) -> String {
    match kind {
        DocKind::Of(Docs { name, body: Shape::Variants(variants), .. }) => {
            let names: Vec<&str> = variants.iter().map(|v| v.name).collect();
            format!("{name}: {}", names.join(", "))
        }
        DocKind::Optional(inner) => format!("{} or None", describe_type(inner)),
        other => other.words(),
    }
}
