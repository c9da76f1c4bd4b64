//! Small YAML files: never deep, never large, and every mistake with its place.

use crate::text::read_text;
use pwrfgs_core::{Error, Result};
use serde::de::DeserializeSeed;
use std::path::Path;

/// Largest file that is read, bytes. It says a few numbers.
pub(crate) const MAX_SIZE: u64 = 1 << 20;
/// Deepest nesting that is read; the parser takes minutes over some ten thousands.
const MAX_DEPTH: usize = 64;

/// The text of a file; `advice` says what to do where it does not exist, `expected` what it should hold.
pub(crate) fn text(path: &Path, advice: &str, expected: &str) -> Result<String> {
    let text = read_text(path, MAX_SIZE, advice)?;
    match too_deep(&text) {
        Some(line) => Err(Error::at(path, line, 1, format!("nested deeper than {MAX_DEPTH}; {expected}"))),
        None => Ok(text),
    }
}

/// What `seed` makes of that text.
pub(crate) fn parse<'a, S: DeserializeSeed<'a>>(
    path: &Path,
    text: &'a str,
    seed: S,
    expected: &str,
) -> Result<S::Value> {
    seed.deserialize(serde_yaml_ng::Deserializer::from_str(text)).map_err(|e| {
        let words = e.to_string();
        let words = words.split(" at line ").next().unwrap_or_default();
        match e.location() {
            Some(place) => Error::at(path, place.line(), place.column(), format!("{words}; {expected}")),
            None => Error::input(path, format!("{words}; {expected}")),
        }
    })
}

/// The line that opens more than [`MAX_DEPTH`] brackets, or holds more list marks. Those in comments and texts count as
/// well, which harms no file that a person writes.
fn too_deep(text: &str) -> Option<usize> {
    let mut depth = 0_usize;
    let is_deeper = |line: &str| {
        for c in line.chars() {
            match c {
                '[' | '{' => depth += 1,
                ']' | '}' => depth = depth.saturating_sub(1),
                _ => {}
            }
            if depth > MAX_DEPTH {
                return true;
            }
        }
        line.split_whitespace().filter(|word| matches!(*word, "-" | "?" | ":")).count() > MAX_DEPTH
    };
    text.lines().position(is_deeper).map(|line| line + 1)
}

/// Line and column of `key` behind `gateway`; the file is known to hold both.
pub(crate) fn place_of(text: &str, gateway: &str, key: &str) -> (usize, usize) {
    // A key begins its line; a comment or a value that holds its letters is none.
    let begins = |(start, line): &(usize, &str)| {
        let own = line.trim_start().trim_start_matches(['"', '\'']);
        let rest = own.strip_prefix(gateway).map(|rest| rest.trim_start_matches(['"', '\'', ' ']));
        rest.is_some_and(|rest| rest.starts_with(':')).then(|| start + line.len() - own.len())
    };
    let lines = text.split_inclusive('\n').scan(0, |next, line| {
        let start = *next;
        *next += line.len();
        Some((start, line))
    });
    let gateway = lines.into_iter().find_map(|line| begins(&line)).or_else(|| text.find(gateway)).unwrap_or(0);
    let at = text[gateway..].find(key).map_or(gateway, |i| gateway + i);
    let before = &text[..at];
    let start_of_line = before.rfind('\n').map_or(0, |i| i + 1);
    (before.matches('\n').count() + 1, before[start_of_line..].chars().count() + 1)
}
