//! Text files whose errors are reported with line and column, both counted from 1.
//!
//! Rows are split here because the `csv` crate gives no column of a field; a quoted field may contain commas but no
//! line end.

use crate::checks::power_fault;
use pwrfgs_core::{Error, MAX_COORDINATE_M, Real, Result, coordinate_fault, files, messages::quoted};
use serde::de::DeserializeOwned;
use serde_saphyr::{Spanned, UserMessageFormatter};
use std::collections::BTreeSet;
use std::sync::{Mutex, PoisonError};
use std::{fmt::Display, io::ErrorKind, path::Path};

/// Largest number of fields of a line: a field needs far more memory than its comma. No table has as many receivers.
const MOST_FIELDS: usize = 1_000_000;
/// Largest YAML file that is read, bytes.
pub(crate) const MAX_YAML: u64 = 1 << 20;

pub(crate) const POINT_ADVICE: &str = "give every point a finite x, y and z in metres, or remove it";
const DBM_ADVICE: &str = "give the power in dBm, or leave the cell empty if the receiver received no signal";
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
    pub(crate) fields: F,
}

impl<F> TextRow<'_, F> {
    /// Returns the error `problem` at a column of this line.
    pub(crate) fn fault(&self, column: usize, problem: impl Display) -> Error {
        Error::at(self.path, self.line, column, problem)
    }

    /// Parses a finite number in a field of this line; `advice` is the next step otherwise.
    pub(crate) fn number(&self, field: TextField<'_>, advice: &str) -> Result<f64> {
        let fault = |problem: &str| self.fault(field.column, format!("{} is {problem}; {advice}", quoted(field.text)));
        let value: f64 = field.text.parse().ok().ok_or_else(|| fault("not a number"))?;
        if (value as Real).is_finite() { Ok(value) } else { Err(fault("not finite")) }
    }

    /// Parses a coordinate, metres: finite and at most 1e8 m; `advice` is the next step otherwise.
    pub(crate) fn coordinate(&self, field: TextField<'_>, advice: &str) -> Result<f64> {
        let value = self.number(field, advice)?;
        if value.abs() <= MAX_COORDINATE_M {
            return Ok(value);
        }
        let problem = format!("{} is beyond {MAX_COORDINATE_M:e} m; {advice}", quoted(field.text));
        Err(self.fault(field.column, problem))
    }

    /// Parses a position in three fields as [`Self::coordinate`] does, metres; `advice` is the next step otherwise.
    pub(crate) fn position(&self, fields: [TextField<'_>; 3], advice: &str) -> Result<[f64; 3]> {
        let [x, y, z] = fields.map(|field| self.coordinate(field, advice));
        Ok([x?, y?, z?])
    }

    /// Parses a power, dBm: from -300 to 300. `None` for an empty cell and for the values `missing`, which mean that no signal was
    /// received.
    pub(crate) fn power(&self, field: TextField<'_>, missing: &[f64]) -> Result<Option<f64>> {
        if is_empty_cell(field.text) {
            return Ok(None);
        }
        let dbm = self.number(field, DBM_ADVICE)?;
        if missing.contains(&dbm) {
            return Ok(None);
        }
        if power_fault(dbm).is_some() {
            let problem = format!("{} is not a power in dBm; {DBM_ADVICE}", quoted(field.text));
            return Err(self.fault(field.column, problem));
        }
        Ok(Some(dbm))
    }
}

impl<'a> TextRow<'a> {
    /// Splits the content of a line at commas.
    pub(crate) fn at_commas(path: &'a Path, (line, content): (usize, &'a str)) -> Self {
        Self { path, line, fields: split_commas(content) }
    }

    /// Splits the content of a line at blanks.
    pub(crate) fn at_blanks(path: &'a Path, (line, content): (usize, &'a str)) -> Self {
        Self { path, line, fields: locate_fields(content, content.split_whitespace()) }
    }

    /// Returns the column behind the last field.
    pub(crate) fn end_column(&self) -> usize {
        self.fields.last().map_or(1, |field| field.column + field.text.chars().count())
    }

    /// Returns an error for a row with more fields than the header, for example due to decimal commas.
    pub(crate) fn check_length(&self, header: usize) -> Result<()> {
        match self.fields.get(header..).and_then(|surplus| surplus.iter().find(|field| !field.text.is_empty())) {
            Some(field) => {
                let (count, advice) = (self.fields.len(), "write decimals with a point, and one value per column");
                Err(self.fault(field.column, format!("the row has {count} fields, its header {header}; {advice}")))
            }
            None => Ok(()),
        }
    }

    /// Returns the field in the column with this index and name. Returns an error if the row is too short.
    pub(crate) fn cell(&self, (column, name): (usize, &str), advice: &str) -> Result<TextField<'a>> {
        self.fields.get(column).copied().ok_or_else(|| {
            let (count, needed, name) = (self.fields.len(), column + 1, quoted(name));
            let problem = format!("the row ends after {count} of the {needed} columns that {name} needs");
            self.fault(self.end_column(), format!("{problem}; {advice}"))
        })
    }

    /// Reads the power in the column of a receiver as [`Self::power`] does. Returns an error if the row is too short.
    pub(crate) fn read_power(&self, column: (usize, &str), missing: &[f64]) -> Result<Option<f64>> {
        self.power(self.cell(column, DBM_ADVICE)?, missing)
    }

    /// Returns the index of the column `name` of a header, in either case; `names` lists every column that the file needs.
    /// A name may begin with a comment mark, as in `CloudCompare`, and end with its unit, as `x [m]`. Returns an error for a
    /// missing or repeated column, or one in another unit.
    fn find_column(&self, name: &str, names: &str) -> Result<usize> {
        let fields = &self.fields;
        let mut columns =
            fields.iter().enumerate().filter(|(_, field)| split_unit(field.text).0.eq_ignore_ascii_case(name));
        let (column, field) = columns.next().ok_or_else(|| {
            let is_separator = |mark: &&str| fields.len() == 1 && fields[0].text.contains(mark);
            let problem = match [";", "\t"].into_iter().find(is_separator) {
                Some(mark) => format!("columns are separated by {mark:?}; separate them by commas"),
                None => format!("no column `{name}`; the first line must name the columns {names}"),
            };
            self.fault(1, problem)
        })?;
        let unit = split_unit(field.text).1;
        if ["x", "y", "z"].contains(&name) && !is_metre(unit) {
            let problem = format!("{} is not in metres; convert the column, and name it `{name}`", quoted(field.text));
            return Err(self.fault(field.column, problem));
        }
        match columns.next() {
            Some((_, second)) => {
                Err(self.fault(second.column, format!("a second column `{name}`; name each of {names} once")))
            }
            None => Ok(column),
        }
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

/// Reads a file of at most `limit` bytes; `advice` is the next step if it does not exist. Returns an error for a
/// missing, irregular or larger file.
pub(crate) fn read_bytes(path: &Path, limit: u64, advice: &str) -> Result<Vec<u8>> {
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

/// Reads a text file of at most `limit` bytes, without a byte order mark; `advice` is the next step if it does not
/// exist. Returns an error for a missing, irregular or larger file, or one that is not UTF-8.
pub(crate) fn read_text(path: &Path, limit: u64, advice: &str) -> Result<String> {
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

/// Returns the lines that are not empty, with their numbers, counted from 1; they end by LF, CR LF, or CR alone.
pub(crate) fn numbered_lines(text: &str) -> impl Iterator<Item = (usize, &str)> {
    let lines = (1..).zip(text.split(if text.contains('\n') { '\n' } else { '\r' }));
    lines.map(|(i, line)| (i, line.strip_suffix('\r').unwrap_or(line))).filter(|(_, line)| !line.trim().is_empty())
}

/// Splits the name of a column into the plain name and the unit in brackets, which is empty if there is none.
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

/// Splits a line at commas into fields without surrounding blanks and quotes; stops after [`MOST_FIELDS`].
fn split_commas(line: &str) -> Vec<TextField<'_>> {
    let mut quoted = false;
    let parts = line.split(|c| {
        quoted ^= c == '"';
        c == ',' && !quoted
    });
    locate_fields(line, parts.take(MOST_FIELDS).map(unquoted))
}

/// Returns a field without surrounding blanks and quotes.
pub(crate) fn unquoted(part: &str) -> &str {
    let text = part.trim();
    text.strip_prefix('"').and_then(|text| text.strip_suffix('"')).unwrap_or(text).trim()
}

/// Returns slices of `line`, in order, each with its column: characters, counted from 1. Columns are counted incrementally:
/// a face of a mesh may have a million corners in one line.
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

/// Returns the problem with a point of a binary file, metres; `None` if it is valid.
pub(crate) fn point_fault(point: [f64; 3]) -> Option<String> {
    let wrong = point.into_iter().find(|v| coordinate_fault(*v).is_some())?;
    Some(if wrong.is_finite() { format!("beyond {MAX_COORDINATE_M:e} m") } else { "not finite".into() })
}

/// Returns the rows of a table, each with its fields in the columns `names`, which the header names among others. Returns an
/// error for a missing column or field, or a row with more fields than the header.
pub(crate) fn table_rows<'a, const N: usize>(
    path: &'a Path,
    text: &'a str,
    names: [&str; N],
    advice: &str,
) -> Result<Vec<TextRow<'a, [TextField<'a>; N]>>> {
    let mut rows = numbered_lines(text);
    let header = rows.next().ok_or_else(|| Error::input(path, format!("is empty; {advice}")))?;
    let (header, all_names) = (TextRow::at_commas(path, header), names.join(", "));
    let columns = names.map(|name| header.find_column(name, &all_names));
    let columns = columns.into_iter().collect::<Result<Vec<usize>>>()?;
    let read = |row| {
        let row = TextRow::at_commas(path, row);
        row.check_length(header.fields.len())?;
        let mut fields = [TextField { text: "", column: 1 }; N];
        for (k, field) in fields.iter_mut().enumerate() {
            *field = row.cell((columns[k], names[k]), advice)?;
        }
        Ok(TextRow { path, line: row.line, fields })
    };
    rows.map(read).collect()
}

/// Columns of x, y and z.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct XyzColumns(pub(crate) [usize; 3]);

impl XyzColumns {
    /// Finds the columns in a header, in any order and either case, among other columns. Returns an error for a missing
    /// or repeated column.
    pub(crate) fn from_header(header: &TextRow<'_>) -> Result<Self> {
        let find = |name| header.find_column(name, "x, y and z");
        Ok(Self([find("x")?, find("y")?, find("z")?]))
    }

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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn split_fields_have_their_columns() {
        let fields = split_commas(" a, \"b,c\" ,,é,d");
        let got: Vec<_> = fields.iter().map(|f| (f.text, f.column)).collect();
        assert_eq!(got, [("a", 2), ("b,c", 6), ("", 12), ("é", 13), ("d", 15)]);
        let last = split_commas(&"é, ".repeat(500_000)).last().map(|f| (f.text.to_owned(), f.column));
        assert_eq!(last, Some((String::new(), 3 * 500_000)), "a long line");
        assert_eq!(split_commas(&",".repeat(2_000_000)).len(), MOST_FIELDS);
        let got: Vec<_> =
            TextRow::at_blanks(Path::new("a"), (1, "1  2\t3")).fields.iter().map(|f| (f.text, f.column)).collect();
        assert_eq!(got, [("1", 1), ("2", 4), ("3", 6)]);
    }
}
