//! Text files whose errors are reported with line and column, both counted from 1.

use crate::checks::power_fault;
use pwrfgs_core::files::ReadLimit;
use pwrfgs_core::{Error, MAX_COORDINATE_M, Real, Result, coordinate_fault, files, messages::quoted};
use serde::de::DeserializeOwned;
use serde_saphyr::{Spanned, UserMessageFormatter};
use std::collections::BTreeSet;
use std::sync::{Mutex, PoisonError};
use std::{fmt::Display, io::ErrorKind, path::Path};

/// Largest YAML file that is read, bytes.
pub(crate) const MAX_YAML: u64 = 1 << 20;

pub(crate) const POINT_ADVICE: &str = "give every point a finite x, y and z in metres, or remove it";
pub(crate) const DBM_ADVICE: &str = "give the power in dBm, or leave the cell empty if the receiver received no signal";
pub(crate) const VERTEX_ADVICE: &str = "give every vertex a finite x, y and z";

/// Field of a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct TextField<'a> {
    pub(crate) text: &'a str,
    /// Column of its first character, counted from 1.
    pub(crate) column: usize,
}

/// Line of a file with its fields: all of them, or an array of those in some columns.
pub(crate) struct TextRow<'a, F = Vec<TextField<'a>>> {
    pub(crate) path: &'a Path,
    /// Line number, counted from 1.
    pub(crate) line: usize,
    pub(crate) has_decimal_commas: bool,
    pub(crate) fields: F,
}

impl<F> TextRow<'_, F> {
    /// Returns the error `problem` at a column of this line.
    pub(crate) fn fault(&self, column: usize, problem: impl Display) -> Error {
        Error::at(self.path, self.line, column, problem)
    }

    /// Parses a number in a field of this line. Returns an error with the next step `advice` for other text, and for a number
    /// that is not finite as [`Real`].
    pub(crate) fn number(&self, field: TextField<'_>, advice: &str) -> Result<f64> {
        let parse = |text: &str| parse_number(text, self.has_decimal_commas);
        let value = parse(field.text).filter(|value| (*value as Real).is_finite());
        value.ok_or_else(|| {
            // A second number makes a list.
            let mut parts = field.text.split([';', ',', ' ']).filter(|part| !part.is_empty()).skip(1);
            let is_list = field.text.starts_with('[') || parts.next().is_some_and(|part| parse(part).is_some());
            let problem = match parse(field.text) {
                Some(_) => format!("is not finite; {advice}"),
                None if is_list => "is a list; write one row per reading, or one column per value".to_owned(),
                None => format!("is not a number; {advice}"),
            };
            self.fault(field.column, format!("{} {problem}", quoted(field.text)))
        })
    }

    /// Parses a number; `None` for an empty cell. Returns the errors of [`Self::number`].
    pub(crate) fn optional(&self, field: TextField<'_>, advice: &str) -> Result<Option<f64>> {
        if is_empty_cell(field.text) { Ok(None) } else { self.number(field, advice).map(Some) }
    }

    /// Parses a coordinate, metres. Returns an error with the next step `advice` unless it is a number of at most 1e8 m.
    pub(crate) fn coordinate(&self, field: TextField<'_>, advice: &str) -> Result<f64> {
        let value = self.number(field, advice)?;
        if value.abs() <= MAX_COORDINATE_M {
            return Ok(value);
        }
        let problem = format!("{} is beyond {MAX_COORDINATE_M:e} m; {advice}", quoted(field.text));
        Err(self.fault(field.column, problem))
    }

    /// Parses a position in three fields, metres. Returns the errors of [`Self::coordinate`].
    pub(crate) fn position(&self, fields: [TextField<'_>; 3], advice: &str) -> Result<[f64; 3]> {
        let [x, y, z] = fields.map(|field| self.coordinate(field, advice));
        Ok([x?, y?, z?])
    }

    /// Parses a power, dBm. `None` for an empty cell and for the values `missing`, which mean that no signal was received.
    /// Returns an error unless it is a number from -300 to 300.
    pub(crate) fn power(&self, field: TextField<'_>, missing: &[f64]) -> Result<Option<f64>> {
        let dbm = self.optional(field, DBM_ADVICE)?.filter(|dbm| !missing.contains(dbm));
        if dbm.is_some_and(|dbm| power_fault(dbm).is_some()) {
            let problem = format!("{} is not a power in dBm; {DBM_ADVICE}", quoted(field.text));
            return Err(self.fault(field.column, problem));
        }
        Ok(dbm)
    }
}

impl<'a> TextRow<'a> {
    /// Splits the content of a line at blanks.
    pub(crate) fn split_at_blanks(path: &'a Path, line: (usize, &'a str)) -> Self {
        Self::split(path, line, char::is_whitespace)
    }

    /// Splits the content of a line at the characters `at`; several in a row separate once.
    pub(crate) fn split(path: &'a Path, (line, content): (usize, &'a str), at: impl Fn(char) -> bool) -> Self {
        let fields = locate_fields(content, content.split(at).filter(|part| !part.is_empty()));
        Self { path, line, has_decimal_commas: false, fields }
    }

    /// Returns the column after the last field; 1 without fields.
    pub(crate) fn end_column(&self) -> usize {
        self.fields.last().map_or(1, |field| field.column + field.text.chars().count())
    }

    /// Returns the field in the column with this index and name. Returns an error if the row is too short.
    pub(crate) fn cell(&self, (column, name): (usize, &str), advice: &str) -> Result<TextField<'a>> {
        self.fields.get(column).copied().ok_or_else(|| {
            let (count, needed, name) = (self.fields.len(), column + 1, quoted(name));
            let problem = format!("the row ends after {count} of the {needed} columns that {name} needs");
            self.fault(self.end_column(), format!("{problem}; {advice}"))
        })
    }
}

/// Warns of a `problem` in a file, once per process: a simulation reads a mesh several times.
pub fn warn_once(path: &Path, problem: impl Display) {
    static SHOWN: Mutex<BTreeSet<String>> = Mutex::new(BTreeSet::new());
    let text = format!("{}: {problem}", path.display());
    if SHOWN.lock().unwrap_or_else(PoisonError::into_inner).insert(text.clone()) {
        tracing::warn!("{text}");
    }
}

/// Reads a file within `limit`; `advice` is the next step if it does not exist. Returns an error for a
/// missing, irregular or larger file.
pub(crate) fn read_bytes(path: &Path, limit: impl Into<ReadLimit>, advice: &str) -> Result<Vec<u8>> {
    files::read_at_most(path, limit).map_err(|source| unreadable_error(path, source, "file", advice))
}

/// Returns the error for a file or folder (`kind`) that cannot be read, with `advice` if it does not exist.
pub(crate) fn unreadable_error(path: &Path, source: std::io::Error, kind: &str, advice: &str) -> Error {
    match source.kind() {
        ErrorKind::NotFound => {
            Error::read(path, std::io::Error::new(source.kind(), format!("no such {kind}; {advice}")))
        }
        _ => Error::read(path, source),
    }
}

/// Reads a text file within `limit`, without a byte order mark; `advice` is the next step if it does not
/// exist. Returns an error for a missing, irregular or larger file, or one that is not UTF-8.
pub(crate) fn read_text(path: &Path, limit: impl Into<ReadLimit>, advice: &str) -> Result<String> {
    files::read_text_at_most(path, limit).map_err(|e| match e {
        Error::Read { source, .. } => unreadable_error(path, source, "file", advice),
        other => other,
    })
}

/// Reads a YAML file; `advice` is the next step if it does not exist, `expected` describes its content. The parser
/// limits depth, number of values and repetitions by aliases. Returns an error for a missing or larger file, or invalid
/// content, with line and column.
pub(crate) fn read_yaml<T: DeserializeOwned>(path: &Path, advice: &str, expected: &str) -> Result<T> {
    let text = read_text(path, MAX_YAML, advice)?;
    let options = serde_saphyr::options! { with_snippet: false };
    serde_saphyr::from_str_with_options(&text, options).map_err(|e| {
        let words = e.render_with_formatter(&UserMessageFormatter);
        let problem = format!("{}; {expected}", words.split(" at line ").next().unwrap_or_default());
        match e.location() {
            Some(at) => Error::at(path, at.line() as usize, at.column() as usize, problem),
            None => Error::input(path, problem),
        }
    })
}

/// Returns the error `problem` at a value of a YAML file.
pub(crate) fn yaml_fault<T>(path: &Path, value: &Spanned<T>, problem: impl Display) -> Error {
    Error::at(path, value.referenced.line() as usize, value.referenced.column() as usize, problem)
}

/// Returns the lines that are not blank, with their numbers, counted from 1. They end by LF or CR LF; by CR alone if the
/// text has no LF.
pub(crate) fn numbered_lines(text: &str) -> impl Iterator<Item = (usize, &str)> {
    let lines = (1..).zip(text.split(if text.contains('\n') { '\n' } else { '\r' }));
    lines.map(|(i, line)| (i, line.strip_suffix('\r').unwrap_or(line))).filter(|(_, line)| !line.trim().is_empty())
}

/// Splits the name of a column into the plain name, without a comment mark, and the unit in brackets, which is empty if
/// there is none.
pub(crate) fn split_unit(text: &str) -> (&str, &str) {
    let text = text.trim_start_matches(['/', '#']).trim_start();
    let (name, unit) = text.split_once(['[', '(']).unwrap_or((text, ""));
    (name.trim_end(), unit.trim_end_matches([']', ')']).trim())
}

/// Returns whether the unit of a coordinate is the metre, or not stated.
pub(crate) fn is_metre(unit: &str) -> bool {
    ["", "m", "metre", "metres", "meter", "meters"].iter().any(|name| unit.eq_ignore_ascii_case(name))
}

/// Cells without a value, in either case.
const EMPTY: [&str; 8] = ["", "-", "na", "n/a", "nan", "null", "none", "nil"];

/// Returns whether a cell holds no value.
pub(crate) fn is_empty_cell(cell: &str) -> bool {
    EMPTY.iter().any(|word| cell.eq_ignore_ascii_case(word))
}

/// Parses a number, with a decimal comma or not; `None` for other text.
pub(crate) fn parse_number(cell: &str, has_decimal_comma: bool) -> Option<f64> {
    if has_decimal_comma { cell.replacen(',', ".", 1).parse().ok() } else { cell.parse().ok() }
}

/// Returns whether a line is a comment: it begins with `#` or `//`.
pub(crate) fn is_comment(line: &str) -> bool {
    let line = line.trim_start();
    line.starts_with('#') || line.starts_with("//")
}

/// Returns the `parts` of `line`, slices of it in order, each with its column: characters, counted from 1. Columns are counted
/// incrementally: a face of a mesh may have a million corners in one line.
pub(crate) fn locate_fields<'a>(line: &'a str, parts: impl Iterator<Item = &'a str>) -> Vec<TextField<'a>> {
    let (mut last, mut column) = (0, 1);
    let field = |text: &'a str| {
        let start = text.as_ptr() as usize - line.as_ptr() as usize;
        column += line[last..start].chars().count();
        last = start;
        TextField { text, column }
    };
    parts.map(field).collect()
}

/// Returns the problem with a point of a binary file, metres, as the words after `is`; `None` if it is valid.
pub(crate) fn point_fault(point: [f64; 3]) -> Option<String> {
    let wrong = point.into_iter().find(|v| coordinate_fault(*v).is_some())?;
    Some(if wrong.is_finite() { format!("beyond {MAX_COORDINATE_M:e} m") } else { "not finite".into() })
}

/// Columns of x, y and z.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct XyzColumns(pub(crate) [usize; 3]);

impl XyzColumns {
    /// Reads the three coordinates of a row, metres. Returns an error if the row is too short or a coordinate is
    /// invalid.
    pub(crate) fn read(self, row: &TextRow<'_>, advice: &str) -> Result<[f64; 3]> {
        let mut point = [0.0; 3];
        for ((value, column), name) in point.iter_mut().zip(self.0).zip(["x", "y", "z"]) {
            *value = row.coordinate(row.cell((column, name), advice)?, advice)?;
        }
        Ok(point)
    }
}
