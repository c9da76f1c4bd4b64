//! `TableText`: a table of any dialect: separators, decimal commas, comment lines, lines before the header, compression.

use crate::text::{TextField, TextRow, is_empty_cell, locate_fields, numbered_lines, read_bytes, unquoted};
use flate2::read::MultiGzDecoder;
use pwrfgs_core::files::MAX_TEXT;
use pwrfgs_core::messages::quoted;
use pwrfgs_core::{Error, Result};
use std::cmp::Reverse;
use std::collections::BTreeMap;
use std::io::Read as _;
use std::path::{Path, PathBuf};

/// Number of lines from which separator and header are recognised.
const EXAMINED: usize = 60;
/// Marks that separate fields, in order of preference.
const MARKS: [char; 4] = ['\t', ';', ',', '|'];

/// File of a table, or its content under the name of a file.
#[derive(Clone, Debug)]
pub struct TableFile {
    /// Path, for messages too.
    pub path: PathBuf,
    /// Content; `None`: that of the file.
    pub bytes: Option<Vec<u8>>,
}

impl From<PathBuf> for TableFile {
    fn from(path: PathBuf) -> Self {
        Self { path, bytes: None }
    }
}

/// Table in memory.
pub(super) struct TableText {
    pub(super) path: PathBuf,
    text: String,
    /// Mark between fields; `None`: blanks.
    mark: Option<char>,
    has_decimal_commas: bool,
    /// Names of the columns; without a header, their numbers from 1.
    pub(super) names: Vec<String>,
    /// Line of the header, from 1; `None` without one.
    pub(super) header: Option<usize>,
    /// Number of lines before the first row.
    skipped: usize,
}

impl TableText {
    /// Reads a table, compressed with gzip or not.
    ///
    /// # Errors
    /// A file that cannot be read, has more than [`MAX_TEXT`] bytes, also expanded, or is no table.
    pub(super) fn read(file: &TableFile) -> Result<Self> {
        let path = &file.path;
        let refuse = |problem: &str| Err(Error::input(path, problem));
        let bytes = file.bytes.clone().map_or_else(|| read_bytes(path, MAX_TEXT, "check the path of the table"), Ok)?;
        if bytes.starts_with(b"PK") {
            return refuse("is an archive, as .xlsx is; save the sheet as CSV and import that");
        }
        let bytes = if bytes.starts_with(&[0x1f, 0x8b]) { expand(path, &bytes)? } else { bytes };
        if bytes.contains(&0) {
            return refuse("is not text; save the table as CSV in UTF-8");
        }
        // Latin-1, as older spreadsheets write it, is a character a byte.
        let text = String::from_utf8(bytes)
            .unwrap_or_else(|e| e.as_bytes().iter().map(|byte| char::from(*byte)).collect())
            .trim_start_matches('\u{feff}')
            .to_owned();
        let mut table = Self {
            path: path.to_owned(),
            text,
            mark: None,
            has_decimal_commas: false,
            names: Vec::new(),
            header: None,
            skipped: 0,
        };
        table.recognise()?;
        Ok(table)
    }

    /// Sets separator, decimal mark, header and names from the first lines. Returns an error for an empty table.
    fn recognise(&mut self) -> Result<()> {
        let text = std::mem::take(&mut self.text);
        let lines: Vec<(usize, &str)> =
            numbered_lines(&text).filter(|(_, line)| !is_comment(line)).take(EXAMINED).collect();
        let (mark, width) = best_separator(&lines);
        self.mark = mark;
        let fits = |line: &&(usize, &str)| split(line.1, mark).len() == width;
        let Some(&(first_line, first)) = lines.iter().find(fits) else {
            return Err(Error::input(&self.path, "holds no row; write one row per reading below a header"));
        };
        let rows: Vec<Vec<&str>> =
            lines.iter().filter(|(line, _)| *line > first_line).map(|(_, line)| split(line, mark)).collect();
        if rows.is_empty() && split(first, mark).iter().all(|cell| cell.parse::<f64>().is_err()) {
            return Err(Error::input(&self.path, "has a header but no row; write one row per reading"));
        }
        let cells = || rows.iter().flatten().copied();
        let is_decimal_comma = |cell: &str| cell.contains(',') && cell.replacen(',', ".", 1).parse::<f64>().is_ok();
        let has_point = cells().any(|cell| cell.contains('.') && cell.parse::<f64>().is_ok());
        self.has_decimal_commas = mark != Some(',') && !has_point && cells().any(is_decimal_comma);
        let is_number = |cell: &str| self.parse_number(cell).is_some();
        // A header names a column that holds numbers.
        let names_numbers = |names: &[&str]| {
            let is_named = |k: usize| {
                let mut values =
                    rows.iter().filter_map(|row| row.get(k)).filter(|cell| !is_empty_cell(cell)).peekable();
                !is_number(names[k]) && values.peek().is_some() && values.all(|cell| is_number(cell))
            };
            names.len() == width && (0..width).any(is_named)
        };
        let above =
            numbered_lines(&text).take_while(|(line, _)| *line < first_line).filter(|(_, line)| is_comment(line));
        let comment = above.last().map(|(line, content)| (line, content.trim_start_matches(['#', '/', ' ', '%'])));
        let first = split(first, mark);
        let (header, names) = match comment.map(|(line, content)| (line, split(content, mark))) {
            _ if names_numbers(&first) => (Some(first_line), first),
            Some((line, names)) if names_numbers(&names) => (Some(line), names),
            _ => (None, Vec::new()),
        };
        self.names = match header {
            Some(_) => names.iter().map(|name| (*name).to_owned()).collect(),
            None => (1..=width).map(|k| k.to_string()).collect(),
        };
        (self.header, self.skipped) = (header, header.unwrap_or(first_line - 1));
        self.text = text;
        Ok(())
    }

    /// Returns the rows below the header. Returns an error for a row with more fields than the header.
    pub(super) fn rows(&self) -> impl Iterator<Item = Result<TextRow<'_>>> {
        let rows = numbered_lines(&self.text).filter(|(line, content)| *line > self.skipped && !is_comment(content));
        rows.map(|(line, content)| {
            let fields = locate_fields(content, split(content, self.mark).into_iter());
            let row = TextRow { path: &self.path, line, fields };
            row.check_length(self.names.len())?;
            Ok(row)
        })
    }

    /// Parses a number with the decimal mark of this table; `None` for other text.
    fn parse_number(&self, cell: &str) -> Option<f64> {
        if self.has_decimal_commas { cell.replacen(',', ".", 1).parse().ok() } else { cell.parse().ok() }
    }

    /// Returns the finite number in a field; `None` for an empty cell. Returns an error with `noun` for other text.
    pub(super) fn number(&self, row: &TextRow<'_>, field: TextField<'_>, noun: &str) -> Result<Option<f64>> {
        if is_empty_cell(field.text) {
            return Ok(None);
        }
        let value = self.parse_number(field.text).filter(|value| value.is_finite());
        value.map(Some).ok_or_else(|| {
            let mut parts = field.text.split([';', ',', ' ']).filter(|part| !part.is_empty()).skip(1);
            let is_list =
                field.text.starts_with('[') || parts.next().is_some_and(|part| self.parse_number(part).is_some());
            let problem = if is_list {
                "is a list; write one row per reading, or one column per value".to_owned()
            } else {
                format!("is not a number; give the {noun} as a number, or leave the cell empty")
            };
            row.fault(field.column, format!("{} {problem}", quoted(field.text)))
        })
    }

    /// Describes the dialect in one sentence.
    pub(super) fn describe(&self) -> String {
        let separator = match self.mark {
            Some('\t') => "tabs".to_owned(),
            Some(mark) => format!("`{mark}`"),
            None => "blanks".to_owned(),
        };
        let decimals = if self.has_decimal_commas { ", decimal commas" } else { "" };
        let header =
            self.header.map_or("no header: columns by number".to_owned(), |line| format!("header in line {line}"));
        format!("{}: separated by {separator}{decimals}, {header}", self.path.display())
    }

    /// Returns the first lines of rows, unchanged.
    pub(super) fn head(&self, count: usize) -> Vec<String> {
        let rows = numbered_lines(&self.text).filter(|(line, _)| Some(*line) == self.header || *line > self.skipped);
        rows.take(count + 1).map(|(_, line)| line.to_owned()).collect()
    }
}

/// Returns the content of a gzip file. Returns an error for a damaged file, or one that expands beyond [`MAX_TEXT`].
fn expand(path: &Path, bytes: &[u8]) -> Result<Vec<u8>> {
    let mut expanded = Vec::new();
    let read = MultiGzDecoder::new(bytes).take(MAX_TEXT + 1).read_to_end(&mut expanded);
    read.map_err(|e| Error::input(path, format!("cannot be expanded: {e}; compress the table again")))?;
    if expanded.len() as u64 > MAX_TEXT {
        let problem = format!("expands beyond the limit of {MAX_TEXT} bytes");
        return Err(Error::input(path, format!("{problem}; import the table in parts")));
    }
    Ok(expanded)
}

/// Returns whether a line is a comment.
fn is_comment(line: &str) -> bool {
    let line = line.trim_start();
    line.starts_with('#') || line.starts_with("//")
}

/// Splits a line at a mark outside quotes, or at blanks, into fields without surrounding blanks and quotes.
fn split(line: &str, mark: Option<char>) -> Vec<&str> {
    let Some(mark) = mark else { return line.split_whitespace().collect() };
    let mut is_quoted = false;
    let parts = line.split(|c| {
        is_quoted ^= c == '"';
        c == mark && !is_quoted
    });
    parts.map(unquoted).collect()
}

/// Returns the separator that gives most lines the same number of fields, at least two, and that number.
fn best_separator(lines: &[(usize, &str)]) -> (Option<char>, usize) {
    let candidates = MARKS.map(Some).into_iter().chain([None]);
    let measured = candidates.map(|mark| {
        let mut counts: BTreeMap<usize, usize> = BTreeMap::new();
        lines.iter().for_each(|(_, line)| *counts.entry(split(line, mark).len()).or_default() += 1);
        let several = counts.into_iter().filter(|(width, _)| *width > 1);
        let (width, support) = several.max_by_key(|(width, n)| (*n, Reverse(*width))).unwrap_or((1, 0));
        (mark, width, support)
    });
    let most = measured.clone().map(|(.., support)| support).max().unwrap_or(0);
    let best = measured.into_iter().find(|(.., support)| *support == most && most > 0);
    best.map_or((Some(','), 1), |(mark, width, _)| (mark, width))
}
