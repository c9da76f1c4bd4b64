//! Limits of an XML file, checked before the parser and before variables are replaced.

use pwrfgs_core::messages::quoted;
use pwrfgs_core::{Error, Result, did_you_mean};
use std::collections::BTreeMap;
use std::path::Path;

/// Largest number of tags.
const MOST_TAGS: usize = 500_000;
/// Largest numbers of attributes of an element and of namespaces: the parser compares each with all others.
const MOST_ATTRIBUTES: usize = 100;
/// Longest value of a variable, and longest attribute with variables before and after they are replaced, bytes.
pub(super) const LONGEST: usize = 1_000;

/// Returns an error for text with too many tags, attributes of a tag or namespaces: the parser would need much memory, or a
/// time that grows with the square of its length. `path` is named in the error.
pub(super) fn check_tags(path: &Path, text: &str) -> Result<()> {
    let mut namespaces = 0;
    for (i, (start, _)) in text.match_indices('<').enumerate() {
        let tag = text[start + 1..].split('<').next().unwrap_or_default();
        namespaces += tag.matches("xmlns").count();
        let attributes = if tag.starts_with(['!', '?']) { 0 } else { tag.matches('=').count() };
        let (most, items) = if i >= MOST_TAGS {
            (MOST_TAGS, "tags")
        } else if attributes > MOST_ATTRIBUTES {
            (MOST_ATTRIBUTES, "attributes")
        } else if namespaces > MOST_ATTRIBUTES {
            (MOST_ATTRIBUTES, "namespaces")
        } else {
            continue;
        };
        let (line, before) = text[..start].split('\n').enumerate().last().unwrap_or_default();
        let problem = format!("more than {most} {items}; cut out a part of the scene");
        return Err(Error::at(path, line + 1, before.chars().count() + 1, problem));
    }
    Ok(())
}

/// Returns `value` of the attribute `name` with each `$variable` replaced by its text. Returns an error for an unknown
/// variable or a result that is too long.
pub(super) fn expand_variables(name: &str, value: &str, variables: &BTreeMap<&str, &str>) -> Result<String, String> {
    let Some((start, rest)) = value.split_once('$') else { return Ok(value.to_owned()) };
    let check = |length: usize| {
        let problem = || format!("`{name}` is longer than 1,000 characters; shorten it or its variables");
        if length <= LONGEST { Ok(()) } else { Err(problem()) }
    };
    check(value.len())?;
    let mut expanded = start.to_owned();
    for part in rest.split('$') {
        // Of all names that begin the text, the longest comes first in reverse order.
        let entry = variables.iter().rev().find(|(variable, _)| part.starts_with(**variable));
        let (variable, text) = entry.ok_or_else(|| {
            let hint = did_you_mean(part, variables.keys().copied());
            format!("unknown variable {}{hint}; add a `default` for it", quoted(&format!("${part}")))
        })?;
        check(expanded.len() + text.len() + part.len() - variable.len())?;
        expanded = expanded + text + &part[variable.len()..];
    }
    Ok(expanded)
}
