//! `Setting`: a value in the text of a pipeline, found by its path, with its type.

use crate::changes::shortened;
use crate::pipeline::Pipeline;
use crate::ron_tree::{RonBody, RonTree};
use pwrfgs_core::did_you_mean;
use pwrfgs_core::docs::{DocBody as Parts, DocField, DocKind, Docs};
use pwrfgs_core::plugin::{PluginFamily, removed_field};
use std::ops::Range;

/// Value in a pipeline, with its type if known.
pub(crate) struct Setting<'a> {
    /// Path, for messages.
    name: String,
    pub(crate) tree: &'a RonTree,
    pub(crate) kind: Option<DocKind>,
}

/// Text range and its replacement.
pub(crate) type TextEdit = (Range<usize>, String);

impl<'a> Setting<'a> {
    /// Finds the value at `path` in the `tree` of a pipeline.
    ///
    /// # Errors
    /// A step of the path is unknown; the message lists the valid ones.
    pub(crate) fn at(path: &str, tree: &'a RonTree) -> Result<Self, String> {
        let mut setting = Self { name: String::new(), tree, kind: Some(DocKind::Of(Docs::of::<Pipeline>())) };
        for step in path.trim().split('.') {
            setting = setting.find_part(step.trim())?;
        }
        Ok(setting)
    }

    /// Finds the part `step` of this value: a field, an element of a list, or the value itself by its name.
    ///
    /// # Errors
    /// There is no such part, or several have this name; the message names the valid ones.
    fn find_part(self, step: &str) -> Result<Self, String> {
        let Self { name, tree, kind } = self;
        let path = if name.is_empty() { step.to_owned() } else { format!("{name}.{step}") };
        let here = if name.is_empty() { "a pipeline".to_owned() } else { format!("`{name}`") };
        if let Some(inner) = tree.field(step) {
            return Ok(Self {
                name: path,
                tree: inner,
                kind: field_docs(kind.as_ref(), tree, step).map(|f| f.kind.clone()),
            });
        }
        if let (Some("Some"), [inner]) = (tree.name.as_deref(), tree.items()) {
            return Self { name, tree: inner, kind }.find_part(step);
        }
        if tree.name.as_deref() == Some(step) && !tree.fields().is_empty() {
            return Ok(Self { name: path, tree, kind });
        }
        let plugin = match kind.as_ref().map(inner_kind) {
            Some(DocKind::Plugin(kind)) => Some(*kind),
            _ => None,
        };
        if let (false, RonBody::Items(items)) = (tree.name.is_some(), &tree.body) {
            let item = |tree| Self { name: path, tree, kind: kind.map(|k| item_kind(&k, step)) };
            return find_item(&here, &name, items, step).map(item);
        }
        Err(unknown_field_fault(&name, tree, plugin, here, step))
    }

    /// Completes a new `value` of this setting to RON: adds quotes around text or a path, and parentheses after the name of a
    /// plugin, if they are omitted.
    pub(crate) fn complete_value(&self, value: &str) -> String {
        let (is_optional, kind) = match &self.kind {
            Some(DocKind::Optional(inner)) => (true, Some(&**inner)),
            other => (false, other.as_ref()),
        };
        let is_text = matches!(kind, Some(DocKind::Plain("text" | "path")))
            || (kind.is_none_or(|k| matches!(k, DocKind::Plain(_))) && self.is_text());
        if is_text {
            let is_quoted = value.starts_with('"') || value.starts_with("r\"") || value.starts_with("r#");
            let is_complete = is_optional && (value == "None" || value.starts_with("Some("));
            return if is_quoted || is_complete { value.to_owned() } else { format!("{value:?}") };
        }
        let is_name = value.starts_with(char::is_alphabetic) && value.chars().all(|c| c.is_alphanumeric() || c == '_');
        let is_none = value == "None" && is_optional;
        let is_plugin = matches!(kind, Some(DocKind::Plugin(_)));
        if is_name && is_plugin && !is_none { format!("{value}()") } else { value.to_owned() }
    }

    /// Returns whether the present value is text.
    fn is_text(&self) -> bool {
        self.tree.name.is_none() && self.tree.body == RonBody::Plain && self.tree.quoted
    }

    /// Adds the edits that replace this value by `new`, a value of `text`, to `edits`. Values of settings and values without
    /// a name replace only the fields that they contain. Returns an error for an unknown field.
    pub(crate) fn replace(self, new: &RonTree, text: &str, edits: &mut Vec<TextEdit>) -> Result<(), String> {
        let has_fields = matches!(self.kind, Some(DocKind::Of(Docs { body: Parts::Fields(_), .. })));
        let merges = has_fields || new.name.is_none();
        if !merges || new.fields().is_empty() || self.tree.fields().is_empty() {
            edits.push((self.tree.span.clone(), new.text_in(text).to_owned()));
            return Ok(());
        }
        for (field, value) in new.fields() {
            let parent = Setting { name: self.name.clone(), tree: self.tree, kind: self.kind.clone() };
            parent.find_part(field)?.replace(value, text, edits)?;
        }
        Ok(())
    }
}

/// Returns the message that the value `tree` has no field `step`. `name` is the path of the value, `here` its name in the
/// message, and `plugin` its kind of plugins; `None` for other values.
fn unknown_field_fault(name: &str, tree: &RonTree, plugin: Option<&'static str>, here: String, step: &str) -> String {
    let plugin_hint = complete_plugin_hint(plugin, name, step);
    let names = || tree.fields().iter().map(|(field, _)| field.as_str());
    let subject = match (plugin, &tree.name) {
        (Some(_), Some(plugin)) => format!("{here} is {plugin}, which"),
        _ => here,
    };
    if let Some(why) = tree.name.as_deref().and_then(|plugin| removed_field(plugin, step)) {
        return format!("{subject} {why}");
    }
    if names().next().is_none() {
        return format!("{subject} has no fields, so `{step}` is unknown{plugin_hint}");
    }
    let mut deeper = if name.is_empty() { paths_to(step, tree) } else { Vec::new() };
    let depth = |path: &String| path.matches('.').count();
    let least = deeper.iter().map(depth).min();
    deeper.retain(|path| Some(depth(path)) == least);
    deeper.truncate(3); // more would hide the list of fields
    let hint = match &deeper[..] {
        [] => did_you_mean(step, names()),
        _ => format!("; did you mean `{}`?", deeper.join("` or `")),
    };
    format!(
        "{subject} has no field {}{hint} (fields: `{}`){plugin_hint}",
        quoted(step),
        names().collect::<Vec<_>>().join("`, `")
    )
}

/// Returns all values inside the value `tree` of `text` that are file paths according to its type `kind`.
pub(crate) fn path_values<'a>(kind: &DocKind, tree: &'a RonTree, text: &str) -> Vec<&'a RonTree> {
    let kind = inner_kind(kind);
    if let (Some("Some"), [inner]) = (tree.name.as_deref(), tree.items()) {
        return path_values(kind, inner, text);
    }
    let docs = match kind {
        DocKind::Plain("path") if tree.quoted => return vec![tree],
        DocKind::Plugin(kind) => PluginFamily::find(kind).and_then(|family| (family.docs)(tree.text_in(text))),
        kind => kind.docs(),
    };
    let variant = tree.name.as_deref();
    let field_kind = |(name, value)| Some((docs?.field(variant, name)?.kind.clone(), value));
    let fields = tree.fields().iter().map(|(name, value)| (name.as_str(), value)).filter_map(field_kind);
    let items = tree.items().iter().enumerate().map(|(index, item)| (item_kind(kind, &index.to_string()), item));
    fields.chain(items).flat_map(|(kind, value)| path_values(&kind, value, text)).collect()
}

/// Returns the documentation of field `name` of the value `tree`, given its type; `None` if it is unknown.
fn field_docs(kind: Option<&DocKind>, tree: &RonTree, name: &str) -> Option<&'static DocField> {
    match kind? {
        DocKind::Of(docs) => docs.field(tree.name.as_deref(), name),
        DocKind::Optional(inner) => field_docs(Some(inner), tree, name),
        DocKind::Plugin(kind) => {
            let members = (PluginFamily::find(kind)?.members)();
            members.iter().find(|m| Some(m.name) == tree.name.as_deref())?.docs?.field(None, name)
        }
        _ => None,
    }
}

/// Returns the inner type of an `Option`, also if nested; all other types unchanged.
fn inner_kind(kind: &DocKind) -> &DocKind {
    if let DocKind::Optional(inner) = kind { inner_kind(inner) } else { kind }
}

/// Returns the type of element `step` of a list or tuple; the type of a tuple without this element, and other types without
/// `Option`.
fn item_kind(kind: &DocKind, step: &str) -> DocKind {
    match inner_kind(kind) {
        DocKind::List(inner) => (**inner).clone(),
        DocKind::Tuple(parts) => step.parse().ok().and_then(|i: usize| parts.get(i)).unwrap_or(kind).clone(),
        other => other.clone(),
    }
}

/// Finds the element `step` of a list: a number, counted from 0, or a unique name. `list` and `path` are for messages.
///
/// # Errors
/// There is no such element, or several have the name.
fn find_item<'a>(list: &str, path: &str, items: &'a [RonTree], step: &str) -> Result<&'a RonTree, String> {
    if let Ok(index) = step.parse::<usize>() {
        let count = items.len();
        let none = || format!("{list} has {count} entries, counted from 0, but no entry {step}");
        return items.get(index).ok_or_else(none);
    }
    let named: Vec<usize> = (0..items.len()).filter(|&i| items[i].name.as_deref() == Some(step)).collect();
    match named[..] {
        [only] => Ok(&items[only]),
        [] => {
            let names: Vec<&str> = items.iter().filter_map(|item| item.name.as_deref()).collect();
            let hint = did_you_mean(step, names.iter().copied());
            let entries = match &names[..] {
                [] if items.is_empty() => "it is empty".to_owned(),
                [] => "its entries have no names; select one by number, from 0".to_owned(),
                names => format!("there are `{}`", names.join("`, `")),
            };
            Err(format!("{list} has no entry {}{hint} ({entries}); to add one, give the complete list", quoted(step)))
        }
        _ => {
            let paths: Vec<String> = named.iter().map(|i| format!("`{path}.{i}`")).collect();
            Err(format!("{list} has {} entries `{step}`; select one: {}", named.len(), paths.join(", ")))
        }
    }
}

/// Returns the paths below `tree` that end in the field `name`.
fn paths_to(name: &str, tree: &RonTree) -> Vec<String> {
    let inner = |step: &str, value: &RonTree| -> Vec<String> {
        paths_to(name, value).into_iter().map(|path| format!("{step}.{path}")).collect()
    };
    let paths_of_field = |(field, value): &(String, RonTree)| {
        let mut paths: Vec<String> = inner(field, value);
        paths.extend((field == name).then(|| name.to_owned()));
        paths
    };
    let items = tree.items();
    let paths_of_item = |(index, item): (usize, &RonTree)| {
        let is_unique = item.name.is_some() && items.iter().filter(|other| other.name == item.name).count() == 1;
        let step = item.name.clone().filter(|_| is_unique && tree.name.is_none());
        inner(&step.unwrap_or_else(|| index.to_string()), item)
    };
    tree.fields().iter().flat_map(paths_of_field).chain(items.iter().enumerate().flat_map(paths_of_item)).collect()
}

/// Returns the hint to give the complete plugin if another plugin of this kind has the field `step`; otherwise empty.
fn complete_plugin_hint(kind: Option<&'static str>, path: &str, step: &str) -> String {
    let members = kind.and_then(PluginFamily::find).map(|family| (family.members)()).unwrap_or_default();
    let other = members.iter().find(|m| m.docs.is_some_and(|docs| docs.field(None, step).is_some()));
    other.map_or_else(String::new, |m| {
        format!("; to switch to another plugin, pass the complete plugin, such as '{path}={}({step}: ..)'", m.name)
    })
}

/// Quotes a text, see [`shortened`].
pub(crate) fn quoted(text: &str) -> String {
    format!("`{}`", shortened(text))
}
