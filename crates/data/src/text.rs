//! Text files whose errors are reported with line and column, both counted from 1.
//!
//! Rows are split here because the `csv` crate gives no column of a field; a quoted field may contain commas but no
//! line end.

use crate::checks::{NOT_RECEIVED, power_fault};
use pwrfgs_core::{Error, MAX_COORDINATE_M, Real, Result, coordinate_fault, files, messages::quoted};
use serde::de::DeserializeOwned;
use serde_saphyr::{Spanned, UserMessageFormatter};
use std::{fmt::Display, io::ErrorKind, path::Path};

/// Largest YAML file that is read, bytes.
pub(crate) const MAX_YAML: u64 = 1 << 20;

pub(crate) const POINT_ADVICE: &str = "give every point a finite x, y and z in metres, or remove it";
const DBM_ADVICE: &str = "give the power in dBm, or -100 if the gateway received no signal";
pub(crate) const VERTEX_ADVICE: &str = "give every vertex a finite x, y and z";

/// Field of a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct TextField<'a> {
    pub(crate) text: &'a str,
    pub(crate) column: usize,
}

/// Reads a file of at most `limit` bytes; `advice` is the next step if it does not exist.
pub(crate) fn read_bytes(path: &Path, limit: u64, advice: &str) -> Result<Vec<u8>> {
    files::read_at_most(path, limit).map_err(|source| unreadable(path, source, "file", advice))
}

/// Error for a file or folder that cannot be read, with `advice` if it does not exist.
pub(crate) fn unreadable(path: &Path, source: std::io::Error, what: &str, advice: &str) -> Error {
    match source.kind() {
        ErrorKind::NotFound => {
            Error::read(path, std::io::Error::new(source.kind(), format!("no such {what}; {advice}")))
        }
        _ => Error::read(path, source),
    }
}

/// Reads a text file of at most `limit` bytes, without a byte order mark.
pub(crate) fn read_text(path: &Path, limit: u64, advice: &str) -> Result<String> {
    files::read_text_at_most(path, limit).map_err(|e| match e {
        Error::Read { source, .. } => unreadable(path, source, "file", advice),
        other => other,
    })
}

/// Reads a YAML file; `advice` is the next step if it does not exist, `expected` describes its content. The parser
/// limits depth, number of values and repetitions by aliases.
pub(crate) fn read_yaml<T: DeserializeOwned>(path: &Path, advice: &str, expected: &str) -> Result<T> {
    let text = read_text(path, MAX_YAML, advice)?;
    let options = serde_saphyr::options! { with_snippet: false };
    serde_saphyr::from_str_with_options(&text, options).map_err(|e| {
        let words = e.render_with_formatter(&UserMessageFormatter);
        let what = format!("{}; {expected}", words.split(" at line ").next().unwrap_or_default());
        let place = e.location().map(|place| (place.line() as usize, place.column() as usize));
        place.map_or_else(|| Error::input(path, &what), |(line, column)| Error::at(path, line, column, &what))
    })
}

/// Error at a value of a YAML file.
pub(crate) fn at<T>(path: &Path, value: &Spanned<T>, what: impl Display) -> Error {
    Error::at(path, value.referenced.line() as usize, value.referenced.column() as usize, what)
}

/// Lines that are not empty, with their numbers.
pub(crate) fn lines(text: &str) -> impl Iterator<Item = (usize, &str)> {
    text.lines().enumerate().map(|(i, line)| (i + 1, line)).filter(|(_, line)| !line.trim().is_empty())
}

/// Fields between commas, without surrounding blanks and quotes.
pub(crate) fn split_commas(line: &str) -> Vec<TextField<'_>> {
    let mut quoted = false;
    let parts = line.split(|c| {
        quoted ^= c == '"';
        c == ',' && !quoted
    });
    placed(
        line,
        parts.map(|part| {
            let text = part.trim();
            text.strip_prefix('"').and_then(|t| t.strip_suffix('"')).unwrap_or(text).trim()
        }),
    )
}

/// Fields between blanks.
pub(crate) fn split_blanks(line: &str) -> Vec<TextField<'_>> {
    placed(line, line.split_whitespace())
}

/// Slices of `line`, in order, each with its column: characters, counted from 1. Columns are counted incrementally: a
/// face of a mesh may have a million corners in one line.
fn placed<'a>(line: &'a str, parts: impl Iterator<Item = &'a str>) -> Vec<TextField<'a>> {
    let (mut last, mut column) = (0, 1);
    let place = |text: &'a str| {
        let start = text.as_ptr() as usize - line.as_ptr() as usize;
        column += line[last..start].chars().count();
        last = start;
        TextField { text, column }
    };
    parts.map(place).collect()
}

/// Parses a finite number; `advice` is the next step otherwise.
pub(crate) fn number(path: &Path, line: usize, field: TextField<'_>, advice: &str) -> Result<f64> {
    let fault = |what: &str| Error::at(path, line, field.column, format!("{} is {what}; {advice}", quoted(field.text)));
    let value: f64 = field.text.parse().ok().ok_or_else(|| fault("not a number"))?;
    if (value as Real).is_finite() { Ok(value) } else { Err(fault("not finite")) }
}

/// Parses a coordinate, metres: finite and at most 1e8 m.
pub(crate) fn coordinate(path: &Path, line: usize, field: TextField<'_>, advice: &str) -> Result<f64> {
    let value = number(path, line, field, advice)?;
    if value.abs() <= MAX_COORDINATE_M {
        return Ok(value);
    }
    let what = format!("{} is beyond {MAX_COORDINATE_M:e} m; {advice}", quoted(field.text));
    Err(Error::at(path, line, field.column, what))
}

/// Problem with a point of a binary file.
pub(crate) fn fault_of(point: [f64; 3]) -> Option<String> {
    let wrong = point.into_iter().find(|v| coordinate_fault(*v).is_some())?;
    Some(if wrong.is_finite() { format!("beyond {MAX_COORDINATE_M:e} m") } else { "not finite".into() })
}

/// Returns an error for a row with more fields than the header, for example due to decimal commas.
pub(crate) fn no_longer(path: &Path, line: usize, row: &[TextField<'_>], header: usize) -> Result<()> {
    match row.get(header..).and_then(|more| more.iter().find(|field| !field.text.is_empty())) {
        Some(field) => {
            let (have, what) = (row.len(), "write decimals with a point, and one value per column");
            Err(Error::at(path, line, field.column, format!("the row has {have} fields, its header {header}; {what}")))
        }
        None => Ok(()),
    }
}

/// Field of a row in the column with this name.
pub(crate) fn cell<'a>(
    path: &Path,
    line: usize,
    row: &[TextField<'a>],
    (column, name): (usize, &str),
    advice: &str,
) -> Result<TextField<'a>> {
    row.get(column).copied().ok_or_else(|| {
        let end = row.last().map_or(1, |f| f.column + f.text.chars().count());
        let (have, need, name) = (row.len(), column + 1, quoted(name));
        Error::at(
            path,
            line,
            end,
            format!("the row ends after {have} of the {need} columns that {name} needs; {advice}"),
        )
    })
}

/// Power in the column of the receiver `name`, dBm; -100 if no signal was received.
pub(crate) fn power(path: &Path, line: usize, row: &[TextField<'_>], column: (usize, &str)) -> Result<f64> {
    dbm(path, line, cell(path, line, row, column, DBM_ADVICE)?)
}

/// Power in a field, dBm; -100 if no signal was received.
pub(crate) fn dbm(path: &Path, line: usize, field: TextField<'_>) -> Result<f64> {
    let dbm = number(path, line, field, DBM_ADVICE)?;
    let stored = dbm as Real as f64; // rounding may give the marker of a missing link
    if dbm != NOT_RECEIVED && [dbm, stored].into_iter().find_map(power_fault).is_some() {
        let what = format!("{} is not a power in dBm; {DBM_ADVICE}", quoted(field.text));
        return Err(Error::at(path, line, field.column, what));
    }
    Ok(dbm)
}

/// Finds the column `name` in a header, in either case; `all` names every column that the file needs.
fn column(path: &Path, line: usize, header: &[TextField<'_>], name: &str, all: &str) -> Result<usize> {
    let mut found = header.iter().enumerate().filter(|(_, field)| field.text.eq_ignore_ascii_case(name));
    let (column, _) = found.next().ok_or_else(|| {
        let other = [";", "\t"].into_iter().find(|other| header.len() == 1 && header[0].text.contains(other));
        let what = match other {
            Some(other) => format!("columns are separated by {other:?}; separate them by commas"),
            None => format!("no column `{name}`; the first line must name the columns {all}"),
        };
        Error::at(path, line, 1, what)
    })?;
    match found.next() {
        Some((_, twice)) => {
            let what = format!("a second column `{name}`; name each of {all} once");
            Err(Error::at(path, line, twice.column, what))
        }
        None => Ok(column),
    }
}

/// Lines of a table with the fields of these columns, which its header names among others.
pub(crate) fn table<'a, const N: usize>(
    path: &Path,
    text: &'a str,
    names: [&str; N],
    advice: &str,
) -> Result<Vec<(usize, [TextField<'a>; N])>> {
    let mut rows = lines(text);
    let (first, header) = rows.next().ok_or_else(|| Error::input(path, format!("is empty; {advice}")))?;
    let (header, all) = (split_commas(header), names.join(", "));
    let columns = names.map(|name| column(path, first, &header, name, &all));
    let columns = columns.into_iter().collect::<Result<Vec<usize>>>()?;
    let read = |(line, row)| {
        let row = split_commas(row);
        no_longer(path, line, &row, header.len())?;
        let mut fields = [TextField { text: "", column: 1 }; N];
        for (k, field) in fields.iter_mut().enumerate() {
            *field = cell(path, line, &row, (columns[k], names[k]), advice)?;
        }
        Ok((line, fields))
    };
    rows.map(read).collect()
}

/// Position in three fields, metres.
pub(crate) fn place(path: &Path, line: usize, fields: [TextField<'_>; 3], advice: &str) -> Result<[f64; 3]> {
    let [x, y, z] = fields.map(|field| coordinate(path, line, field, advice));
    Ok([x?, y?, z?])
}

/// Columns of x, y and z.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct XyzColumns(pub(crate) [usize; 3]);

impl XyzColumns {
    /// Finds the columns in a header, in any order and either case, among other columns.
    pub(crate) fn from_header(path: &Path, line: usize, header: &[TextField<'_>]) -> Result<Self> {
        let find = |name| column(path, line, header, name, "x, y and z");
        Ok(Self([find("x")?, find("y")?, find("z")?]))
    }

    /// The three coordinates of a row.
    pub(crate) fn read(self, path: &Path, line: usize, row: &[TextField<'_>], advice: &str) -> Result<[f64; 3]> {
        let mut point = [0.0; 3];
        for ((value, column), name) in point.iter_mut().zip(self.0).zip(["x", "y", "z"]) {
            *value = coordinate(path, line, cell(path, line, row, (column, name), advice)?, advice)?;
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
        let got: Vec<_> = split_blanks("1  2\t3").iter().map(|f| (f.text, f.column)).collect();
        assert_eq!(got, [("1", 1), ("2", 4), ("3", 6)]);
    }
}
