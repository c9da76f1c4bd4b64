//! Text format of durations, tables and CSV; [`number`] and others format numbers.

use pwrfgs_core::files::read_text;
use pwrfgs_core::messages::cell;
pub use pwrfgs_core::messages::join_names;
pub use pwrfgs_core::numbers::{fixed, grouped, number};
use pwrfgs_core::{Error, Result};
use serde::de::DeserializeOwned;
use std::path::Path;

/// Quotes a CSV field if needed, and prevents its interpretation as a formula by spreadsheets.
pub fn csv_field(name: &str) -> String {
    let name = cell(name);
    if name.contains([',', '"', '\n', '\r']) { format!("\"{}\"", name.replace('"', "\"\"")) } else { name.into() }
}

/// Formats a duration: `42 s`, `3 min 20 s`, `2 h 05 min`.
pub fn format_duration(seconds: f64) -> String {
    let s = seconds.max(0.0).round() as u64;
    match s {
        0..60 => format!("{s} s"),
        60..3600 => format!("{} min {:02} s", s / 60, s % 60),
        _ => format!("{} h {:02} min", s / 3600, s / 60 % 60),
    }
}

/// Formats a number of bytes in gigabytes: `0.41 GB`.
pub fn format_gigabytes(bytes: u64) -> String {
    format!("{:.2} GB", bytes as f64 / 1e9)
}

/// Formats a length in a suitable unit: `3.1 mm`, `42 cm`, `1.50 m`; `n/a` if it is not finite.
pub fn format_length(metres: f64) -> String {
    match metres {
        m if !m.is_finite() => "n/a".into(),
        m if m < 0.1 => format!("{:.1} mm", m * 1e3),
        m if m < 1.0 => format!("{:.0} cm", m * 1e2),
        m => format!("{m:.2} m"),
    }
}

/// Longest table cell, characters; longer cells are truncated. File names are shorter.
const CELL: usize = 1_000;

/// Truncates a cell of more than [`CELL`] characters, with `..` at the end.
fn truncate_cell(cell: &str) -> String {
    match cell.char_indices().nth(CELL) {
        Some((end, _)) => format!("{}..", &cell[..end]),
        None => cell.to_owned(),
    }
}

/// Aligns columns, two blanks apart: the first `left` to the left, the others to the right. A left cell without text to its
/// right does not widen its column. Cells are truncated to 1,000 characters, and empty lines are omitted.
pub fn align_columns(lines: &[Vec<String>], left: usize) -> String {
    let lines: Vec<Vec<String>> =
        lines.iter().map(|line| line.iter().map(|cell| truncate_cell(cell)).collect()).collect();
    let columns = lines.iter().map(Vec::len).max().unwrap_or(0);
    let is_last = |line: &[String], k: usize| line[k + 1..].iter().all(String::is_empty);
    let width = |line: &Vec<String>, k: usize| {
        let cell = line.get(k).filter(|_| k >= left || !is_last(line, k));
        cell.map_or(0, |cell| cell.chars().count())
    };
    let widths: Vec<usize> = (0..columns).map(|k| lines.iter().map(|l| width(l, k)).max().unwrap_or(0)).collect();
    let cell = |(k, (cell, w)): (usize, (&String, &usize))| {
        if k < left { format!("{cell:<w$}") } else { format!("{cell:>w$}") }
    };
    let text = |line: &Vec<String>| line.iter().zip(&widths).enumerate().map(cell).collect::<Vec<_>>().join("  ");
    let texts = lines.iter().map(|line| text(line).trim_end().to_owned() + "\n");
    texts.filter(|text| text.len() > 1).collect()
}

/// Wraps words into lines of at most `width` characters, unless one word is longer; `starts` are the prefixes of the first and
/// of further lines.
pub fn wrap_words(words: &str, starts: [&str; 2], width: usize) -> String {
    let (mut out, mut line) = (String::new(), String::new());
    for word in words.split_whitespace() {
        if line.is_empty() {
            line = starts[0].to_owned() + word;
        } else if line.chars().count() + 1 + word.chars().count() > width {
            out = out + &line + "\n";
            line = starts[1].to_owned() + word;
        } else {
            line = line + " " + word;
        }
    }
    out + &line + "\n"
}

/// CSV file with K columns.
#[derive(Debug)]
pub struct Lines<const K: usize>(csv::Writer<Vec<u8>>);

impl<const K: usize> Lines<K> {
    /// Creates a file with only the header.
    pub fn new(header: [&str; K]) -> Self {
        let mut lines = Self(csv::Writer::from_writer(Vec::new()));
        lines.put(header);
        lines
    }

    /// Appends a line.
    pub fn put(&mut self, fields: [&str; K]) {
        let fields = fields.map(cell);
        self.0
            .write_record(fields.iter().map(|field| field.as_bytes()))
            .expect("memory takes every line, and all have K fields");
    }

    /// Returns the text of the whole file.
    pub fn text(self) -> String {
        String::from_utf8(self.0.into_inner().unwrap_or_default()).unwrap_or_default()
    }
}

/// Reads the rows of a CSV file written by a run.
///
/// # Errors
/// [`Error::Read`], or [`Error::Input`] with the line if a row is damaged or the last one is incomplete.
pub(crate) fn read_csv_rows<T: DeserializeOwned>(path: &Path) -> Result<Vec<T>> {
    let text = read_text(path)?;
    if !text.ends_with('\n') {
        return Err(damaged(path, text.lines().count().max(1), "the file ends before the end of a row"));
    }
    let located = |e: csv::Error| {
        let problem = match e.kind() {
            csv::ErrorKind::Deserialize { err, .. } => err.kind().to_string(),
            _ => "the row has another number of fields than the first line".into(),
        };
        damaged(path, e.position().map_or(1, |p| p.line() as usize), &problem)
    };
    csv::Reader::from_reader(text.as_bytes()).into_deserialize().map(|row| row.map_err(located)).collect()
}

/// Creates the error of a damaged `line`, counted from 1, of the run file `path`.
pub(crate) fn damaged(path: &Path, line: usize, problem: &str) -> Error {
    let advice = "run files must not be edited; restore it, or repeat the run in another folder";
    Error::at(path, line, 1, format!("{problem}; {advice}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn durations_are_readable() {
        assert_eq!([42.2, 200.0, 7530.0].map(format_duration), ["42 s", "3 min 20 s", "2 h 05 min"]);
    }

    #[test]
    fn wraps_words_into_lines() {
        assert_eq!(wrap_words("aa bb cc", ["// "; 2], 8), "// aa bb\n// cc\n");
        let text = wrap_words(&"twelve chars ".repeat(20), ["pose  ", "      "], 100);
        assert!(text.starts_with("pose  twelve") && text.lines().count() > 2);
        assert!(text.lines().all(|line| line.chars().count() <= 100));
        assert!(text.lines().skip(1).all(|line| line.starts_with("      t") || line.starts_with("      c")));
    }

    #[test]
    fn aligns_columns_by_characters_not_bytes() {
        let lines = [["λ", "1"], ["ab", "23"], ["", ""]].map(|line| line.map(str::to_owned).to_vec());
        assert_eq!(align_columns(&lines, 1), "λ    1\nab  23\n");
        let long = vec![vec!["x".repeat(100_000), "1".into()]];
        assert_eq!(align_columns(&long, 1).len(), 1_000 + 2 + 2 + 1 + 1, "cut, two points, two blanks, 1, end of line");
    }
}
