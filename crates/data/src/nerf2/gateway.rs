//! `gateway_info.yml`: name of the data set, position and orientation of the receiver.

use crate::text::read_text;
use pwrfgs_core::{Error, Pose, Result};
use serde::Deserialize;
use serde_yaml_ng::Value;
use std::path::Path;

const EXPECTED: &str =
    "expected `gateway1: {position: [x, y, z], orientation: [x, y, z, w]}` (metres; unit quaternion)";

/// Largest file that is read, bytes. It says a few numbers.
const MAX_SIZE: u64 = 1 << 20;
/// Deepest nesting that is read; the parser takes minutes over some ten thousands.
const MAX_DEPTH: usize = 64;

/// What the file says.
#[derive(Debug, PartialEq)]
pub(crate) struct Gateway {
    pub(crate) name: Option<String>,
    pub(crate) pose: Pose,
}

#[derive(Deserialize)]
struct File {
    dataset_name: Option<Value>,
    gateway1: Pose,
}

/// Reads the file.
pub(crate) fn read(path: &Path, advice: &str) -> Result<Gateway> {
    let text = read_text(path, MAX_SIZE, advice)?;
    if let Some(line) = too_deep(&text) {
        return Err(Error::at(path, line, 1, format!("nested deeper than {MAX_DEPTH}; {EXPECTED}")));
    }
    let file: File = serde_yaml_ng::from_str(&text).map_err(|e| {
        let words = e.to_string();
        let words = words.split(" at line ").next().unwrap_or_default();
        match e.location() {
            Some(place) => Error::at(path, place.line(), place.column(), format!("{words}; {EXPECTED}")),
            None => Error::input(path, format!("{words}; {EXPECTED}")),
        }
    })?;
    if let Some((field, fault)) = file.gateway1.fault() {
        let (line, column) = place_of(&text, field);
        return Err(Error::at(path, line, column, fault));
    }
    let name = file.dataset_name.and_then(|name| match name {
        Value::String(name) => Some(name),
        Value::Number(number) => Some(number.to_string()),
        _ => None,
    });
    Ok(Gateway { name: name.filter(|n| !n.trim().is_empty()), pose: file.gateway1 })
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

/// Line and column of `key` behind `gateway1`; the file is known to hold both.
fn place_of(text: &str, key: &str) -> (usize, usize) {
    let gateway = text.find("gateway1").unwrap_or(0);
    let at = text[gateway..].find(key).map_or(gateway, |i| gateway + i);
    let before = &text[..at];
    let start_of_line = before.rfind('\n').map_or(0, |i| i + 1);
    (before.matches('\n').count() + 1, before[start_of_line..].chars().count() + 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read_str(text: &str) -> Result<Gateway, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("g.yml");
        std::fs::write(&path, text).unwrap();
        read(&path, "").map_err(|e| e.to_string().replace(&folder.path().display().to_string(), "DIR"))
    }

    #[test]
    fn the_released_file_is_read() {
        let text = "dataset_name: s23\ngateway1:\n  position: [5.0, 0.26, 0]\n  \
                    orientation: [0.51291602, -0.48674136, -0.48674136, 0.51291602]  # quaternion\n";
        let gateway = read_str(text).unwrap();
        assert_eq!(gateway.name.as_deref(), Some("s23"));
        assert_eq!(gateway.pose.position, [5.0, 0.26, 0.0]);
        assert_eq!(gateway.pose.orientation[1], -0.486_741_36);
        let crlf = read_str(&text.replace('\n', "\r\n")).unwrap();
        assert_eq!(crlf, gateway);
    }

    #[test]
    fn mistakes_are_told_with_their_place() {
        let file = |orientation: &str| format!("gateway1:\n  position: [0, 0, 0]\n  orientation: {orientation}\n");
        let cases = [
            (
                file("[0, 0, 0, 0]"),
                "DIR/g.yml:3:3: the quaternion is zero; write x, y, z, w of length 1, such as [0, 0, 0, 1] for no rotation",
            ),
            (
                file("[0, 0, 0, 1.002]"),
                "DIR/g.yml:3:3: the quaternion has length 1.002000, further than 0.001 from 1; divide x, y, z, w by it",
            ),
            (
                file("[0, .nan, 0, 1]"),
                "DIR/g.yml:3:3: the quaternion is not finite; write x, y, z, w, such as [0, 0, 0, 1] for no rotation",
            ),
            (
                "gateway1: {position: [.inf, 0, 0], orientation: [0, 0, 0, 1]}".into(),
                "DIR/g.yml:1:12: the position is not finite; write three numbers in metres",
            ),
        ];
        for (text, message) in cases {
            assert_eq!(read_str(&text).unwrap_err(), message);
        }
        assert!(read_str(&file("[0, 0, 0, 1.0009]")).is_ok());
    }

    #[test]
    fn deep_nesting_and_large_files_are_refused_at_once() {
        let start = std::time::Instant::now();
        let spaces = (0..1_400).map(|i| format!("{:i$}a:\n", ""));
        let cases = [
            ("[".repeat(100_000), "DIR/g.yml:1:1: nested deeper than 64; "),
            (format!("a: b\nc: {}", "{a: ".repeat(100_000)), "DIR/g.yml:2:1: nested deeper than 64; "),
            ("[\n".repeat(100_000), "DIR/g.yml:65:1: nested deeper than 64; "),
            ("- ".repeat(100_000), "DIR/g.yml:1:1: nested deeper than 64; "),
            ("? ".repeat(100_000), "DIR/g.yml:1:1: nested deeper than 64; "),
            (spaces.collect(), "DIR/g.yml"),
            ("&a [*a]\n".repeat(10_000), "DIR/g.yml"),
            ("#".repeat(1 << 20) + "\n", "cannot read DIR/g.yml: it is larger than the 1048576 bytes"),
        ];
        for (text, message) in cases {
            let said = read_str(&text).unwrap_err();
            assert!(said.starts_with(message), "{said}");
        }
        assert!(start.elapsed().as_secs() < 5, "{:?}", start.elapsed());
    }

    #[test]
    fn the_parsers_words_are_kept() {
        let cases = [
            ("gateway2: 1\n", "DIR/g.yml:1:1: missing field `gateway1`"),
            ("gateway1:\n  position: [0, 0]\n", "DIR/g.yml:2:13: gateway1.position: invalid length 2"),
            ("gateway1: [\n", "DIR/g.yml:"),
        ];
        for (text, start) in cases {
            let message = read_str(text).unwrap_err();
            assert!(message.starts_with(start) && message.ends_with(EXPECTED), "{message}");
            assert!(!message.contains("at line"), "{message}");
        }
    }
}
