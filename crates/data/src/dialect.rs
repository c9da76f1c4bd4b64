//! `TableText`: a table of any dialect: separators, decimal commas, comment lines, lines before the header, compression.
//!
//! Rows are split here because the `csv` crate gives no column of a field; a quoted field may contain commas but no line end.

use crate::text::{
    TextField, TextRow, is_comment, is_empty_cell, is_metre, locate_fields, numbered_lines, parse_number, read_bytes,
    split_unit,
};
use flate2::read::MultiGzDecoder;
use pwrfgs_core::files::ReadLimit;
use pwrfgs_core::messages::quoted;
use pwrfgs_core::{Error, Progress, Result, check_memory};
use std::borrow::Cow;
use std::cmp::Reverse;
use std::collections::BTreeMap;
use std::ffi::OsString;
use std::io::{self, Read as _};
use std::path::{Path, PathBuf};

/// Number of lines from which separator and header are recognised.
const EXAMINED: usize = 60;
/// Separators in order of preference; `None`: blanks.
const MARKS: [Option<char>; 5] = [Some('\t'), Some(';'), Some(','), Some('|'), None];
/// First bytes of a zip archive, and of a gzip file.
const ZIP: &[u8] = b"PK\x03\x04";
const GZIP: &[u8] = b"\x1f\x8b";
/// Limit of the file of a table, whose text may be converted. [`TableText::check_rows`] limits what is read from it.
const MAX_TABLE: ReadLimit = ReadLimit::Held(2);
/// Next step for a table that does not fit into memory.
pub(crate) const SPLIT_ADVICE: &str = "give the table in parts";
/// Largest size of a compressed table after expansion, bytes: its file may be a thousand times smaller.
const MAX_EXPANDED: u64 = 1 << 28;
/// Memory of a growing list in units of its length: while it grows, its old space and twice that exist together.
pub(crate) const GROWING: usize = 3;
/// Largest number of fields of a line: a field needs far more memory than its comma. No table has as many receivers.
const MOST_FIELDS: usize = 1_000_000;

/// Header of a table: line number, the line, and the line without a comment mark, which has the names.
type HeaderLine<'t> = (usize, &'t str, &'t str);

/// File of a table, or its content under the name of a file.
#[derive(Clone, Debug)]
pub struct TableFile {
    /// Path, for messages too.
    pub path: PathBuf,
    /// Content; `None`: that of the file.
    pub bytes: Option<Vec<u8>>,
}

impl From<OsString> for TableFile {
    fn from(path: OsString) -> Self {
        Self { path: path.into(), bytes: None }
    }
}

/// Table in memory.
pub(crate) struct TableText<'a> {
    pub(crate) path: &'a Path,
    text: Cow<'a, str>,
    /// Mark between fields; `None`: blanks.
    mark: Option<char>,
    has_decimal_commas: bool,
    /// Names of the columns; without a header, their numbers from 1.
    pub(crate) names: Vec<String>,
    /// Column of each name in its line.
    name_columns: Vec<usize>,
    /// Line of the header, from 1; `None` without one.
    pub(crate) header: Option<usize>,
    /// Number of lines before the first row.
    skipped: usize,
}

impl<'a> TableText<'a> {
    /// Reads a table, compressed with gzip or not; its header is recognised by the numbers below it.
    ///
    /// # Errors
    /// A file that cannot be read, does not fit into memory, expands beyond [`MAX_EXPANDED`], or is no table.
    pub(crate) fn read(file: &'a TableFile) -> Result<Self> {
        let bytes = match &file.bytes {
            Some(bytes) => Cow::Borrowed(&bytes[..]),
            None => read_bytes(&file.path, MAX_TABLE, "check the path of the table")?.into(),
        };
        let mut table = Self::decode(&file.path, bytes)?;
        table.recognise()?;
        Ok(table)
    }

    /// Reads a file whose header has names that `is_name` accepts; `advice` is the next step for a missing or empty
    /// file. The header is the line among the first [`EXAMINED`] with the most such names; without any, the first line
    /// that is no comment if it holds no number. Returns an error for a file that cannot be read, is empty or is no
    /// table.
    pub(crate) fn with_names(path: &'a Path, advice: &str, is_name: &dyn Fn(&str) -> bool) -> Result<Self> {
        let mut table = Self::decode(path, read_bytes(path, MAX_TABLE, advice)?.into())?;
        let text = std::mem::take(&mut table.text);
        let Some((first_line, first)) = numbered_lines(&text).find(|(_, line)| !is_comment(line)) else {
            return Err(Error::input(path, format!("is empty; {advice}")));
        };
        // A header in a comment begins with its mark, but a name may begin with it, too.
        let lines = numbered_lines(&text)
            .take(EXAMINED)
            .flat_map(|(n, line)| [(n, line, line), (n, line, strip_comment_mark(line))]);
        let name_count = |line: &str, mark| split(line, mark).filter(|cell| is_name(cell)).count();
        let ranked = lines.flat_map(|line @ (.., names)| MARKS.map(|mark| (name_count(names, mark), mark, line)));
        let best = ranked.reduce(|best, other| if other.0 > best.0 { other } else { best });
        let best = best.filter(|(count, ..)| *count > 0);
        table.mark = best.map_or_else(|| detect_separator(&text).0, |(_, mark, _)| mark);
        let has_number = split(first, table.mark).any(|cell| cell.parse::<f64>().is_ok());
        let header = best.map(|(.., line)| line).or((!has_number).then_some((first_line, first, first)));
        table.skipped = header.map_or(first_line - 1, |(line, ..)| line);
        table.set_names(header, split(first, table.mark).count());
        table.has_decimal_commas = table.has_decimal_commas_in(&text);
        table.text = text;
        Ok(table)
    }

    /// Decodes the content of a file, whose dialect is still to be set. Returns an error for an archive, a damaged gzip file, or
    /// content that is not text.
    fn decode(path: &'a Path, bytes: Cow<'a, [u8]>) -> Result<Self> {
        let refuse = |problem: &str| Err(Error::input(path, problem));
        if bytes.starts_with(ZIP) {
            return refuse("is an archive, as .xlsx is; save the sheet as CSV and import that");
        }
        let bytes = if bytes.starts_with(GZIP) { expand(path, &bytes)?.into() } else { bytes };
        if bytes.contains(&0) {
            return refuse("is not text; save the table as CSV in UTF-8");
        }
        // Latin-1, as older spreadsheets write it, has one byte per character.
        let latin = |bytes: &[u8]| bytes.iter().map(|byte| char::from(*byte)).collect::<String>();
        let byte_order_mark = "\u{feff}".as_bytes();
        let start = if bytes.starts_with(byte_order_mark) { byte_order_mark.len() } else { 0 };
        let text = match bytes {
            Cow::Borrowed(bytes) => {
                let bytes = &bytes[start..];
                std::str::from_utf8(bytes).map_or_else(|_| latin(bytes).into(), Cow::Borrowed)
            }
            Cow::Owned(mut bytes) => {
                bytes.drain(..start);
                String::from_utf8(bytes).unwrap_or_else(|e| latin(e.as_bytes())).into()
            }
        };
        let (names, name_columns) = (Vec::new(), Vec::new());
        Ok(Self { path, text, mark: None, has_decimal_commas: false, names, name_columns, header: None, skipped: 0 })
    }

    /// Sets separator, decimal mark, header and names from the first lines. Returns an error for a table without a row.
    fn recognise(&mut self) -> Result<()> {
        let text = std::mem::take(&mut self.text);
        let (mark, width) = detect_separator(&text);
        self.mark = mark;
        let lines = || numbered_lines(&text).filter(|(_, line)| !is_comment(line)).take(EXAMINED);
        let Some((first_line, first)) = lines().find(|(_, line)| split(line, mark).count() == width) else {
            return Err(Error::input(self.path, "holds no row; write one row per reading below a header"));
        };
        let rows = lines().filter(|(line, _)| *line > first_line).map(|(_, line)| split(line, mark).collect());
        let rows: Vec<Vec<&str>> = rows.collect();
        if rows.is_empty() && split(first, mark).all(|cell| cell.parse::<f64>().is_err()) {
            return Err(Error::input(self.path, "has a header but no row; write one row per reading"));
        }
        self.skipped = first_line; // a name may have a comma or a point
        self.has_decimal_commas = self.has_decimal_commas_in(&text);
        let is_number = |cell: &str| parse_number(cell, self.has_decimal_commas).is_some();
        // A header names a column that holds numbers.
        let names_numbers = |&(.., names): &HeaderLine<'_>| {
            let names: Vec<&str> = split(names, mark).collect();
            let is_named = |k: usize| !is_number(names[k]) && has_numbers(&rows, k, &is_number);
            names.len() == width && (0..width).any(is_named)
        };
        let above = numbered_lines(&text).take_while(|(line, _)| *line < first_line);
        let comment =
            above.filter(|(_, line)| is_comment(line)).last().map(|(n, line)| (n, line, strip_comment_mark(line)));
        let header = [Some((first_line, first, first)), comment].into_iter().flatten().find(names_numbers);
        self.skipped = header.map_or(first_line - 1, |(line, ..)| line);
        self.set_names(header, width);
        self.text = text;
        Ok(())
    }

    /// Sets the names, and the line of the header; without a header, the names are the numbers 1 to `width`.
    fn set_names(&mut self, header: Option<HeaderLine<'_>>, width: usize) {
        let fields = |(_, line, names)| locate_fields(line, split(names, self.mark));
        let fields: Vec<TextField<'_>> = header.map_or_else(Vec::new, fields);
        self.header = header.map(|(line, ..)| line);
        self.name_columns = fields.iter().map(|field| field.column).collect();
        self.names = match header {
            Some(_) => fields.iter().map(|field| field.text.to_owned()).collect(),
            None => (1..=width).map(|k| k.to_string()).collect(),
        };
    }

    /// Returns whether the first rows, below the lines `skipped` so far, have decimal commas and no decimal points; false if
    /// commas separate fields.
    fn has_decimal_commas_in(&self, text: &str) -> bool {
        let lines = || numbered_lines(text).filter(|(n, line)| *n > self.skipped && !is_comment(line)).take(EXAMINED);
        let has = |mark: char| {
            let is_decimal = |cell: &str| cell.contains(mark) && parse_number(cell, mark == ',').is_some();
            lines().any(|(_, line)| split(line, self.mark).any(is_decimal))
        };
        self.mark != Some(',') && !has('.') && has(',')
    }

    /// Returns the rows below the header, without comments. A row with text beyond the columns of the header is an error, for
    /// example due to decimal commas.
    pub(crate) fn rows(&self) -> impl Iterator<Item = Result<TextRow<'_>>> {
        let width = if self.header.is_some() { self.names.len() } else { MOST_FIELDS };
        let lines = numbered_lines(&self.text).filter(|(line, content)| *line > self.skipped && !is_comment(content));
        let rows = lines.map(|(line, content)| {
            let fields = locate_fields(content, split(content, self.mark));
            TextRow { path: self.path, line, has_decimal_commas: self.has_decimal_commas, fields }
        });
        rows.map(move |row| match row.fields.iter().skip(width).find(|field| !field.text.is_empty()) {
            Some(field) => {
                let (count, advice) = (row.fields.len(), "write decimals with a point, and one value per column");
                Err(row.fault(field.column, format!("the row has {count} fields, its header {width}; {advice}")))
            }
            None => Ok(row),
        })
    }

    /// Returns the rows or errors of [`Self::rows`]; `progress` counts lines, blank ones too.
    pub(crate) fn counted_rows(&self, progress: Progress<'_>) -> impl Iterator<Item = Result<TextRow<'_>>> {
        /// Number of lines between two reports of progress.
        const STEP: usize = 256;
        let total = numbered_lines(&self.text).last().map_or(0, |(line, _)| line);
        self.rows().inspect(move |row| {
            if let Ok(TextRow { line, .. }) = row
                && line % STEP == 0
            {
                progress(*line, total);
            }
        })
    }

    /// Returns the number of lines that are not blank: an upper limit of the number of rows.
    pub(crate) fn line_count(&self) -> usize {
        numbered_lines(&self.text).count()
    }

    /// Rejects a table whose rows do not fit into memory, with this many bytes each.
    pub(crate) fn check_rows(&self, row_bytes: usize) -> Result<()> {
        let bytes = self.line_count() as u64 * row_bytes as u64;
        check_memory(bytes, SPLIT_ADVICE).map_err(|fault| Error::input(self.path, fault))
    }

    /// Returns the error `problem` at the name of column `k`, or at the header.
    pub(crate) fn fault(&self, k: Option<usize>, problem: impl std::fmt::Display) -> Error {
        let column = k.and_then(|k| self.name_columns.get(k)).copied().unwrap_or(1);
        Error::at(self.path, self.header.unwrap_or(1), column, problem)
    }

    /// Returns the index of the column `name`, in either case; `names` lists every column that the file needs. A name may begin
    /// with a comment mark, as in `CloudCompare`, and end with its unit, as `x [m]`. Returns an error for a missing or repeated
    /// column, or one in another unit.
    pub(crate) fn column(&self, name: &str, names: &str) -> Result<usize> {
        let mut columns = (0..self.names.len()).filter(|k| is_named(&self.names[*k], name));
        let column = columns.next().ok_or_else(|| {
            self.fault(None, format!("no column `{name}`; the first line must name the columns {names}"))
        })?;
        if ["x", "y", "z"].contains(&name) && !is_metre(split_unit(&self.names[column]).1) {
            let problem = format!("{} is not in metres", quoted(&self.names[column]));
            return Err(self.fault(Some(column), format!("{problem}; convert the column, and name it `{name}`")));
        }
        match columns.next() {
            Some(second) => {
                Err(self.fault(Some(second), format!("a second column `{name}`; name each of {names} once")))
            }
            None => Ok(column),
        }
    }

    /// Describes the dialect in one sentence.
    pub(crate) fn describe(&self) -> String {
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

    /// Returns the header and the lines below it, unchanged, at most `count` + 1 in all.
    pub(crate) fn head(&self, count: usize) -> Vec<String> {
        let rows = numbered_lines(&self.text).filter(|(line, _)| Some(*line) == self.header || *line > self.skipped);
        rows.take(count + 1).map(|(_, line)| line.to_owned()).collect()
    }
}

/// Reads a table that has the columns `names` among others, in either case: the results of `read` for each row, whose fields
/// are in that order; `advice` says what to write.
///
/// # Errors
/// A file that cannot be read or has no row, a missing or repeated column, a row that is too short or too long, and those of
/// `read`; the message has line and column.
pub(crate) fn read_columns<T, const N: usize>(
    path: &Path,
    names: [&str; N],
    advice: &str,
    mut read: impl FnMut(&TextRow<'_, [TextField<'_>; N]>) -> Result<T>,
) -> Result<Vec<T>> {
    let list = names.join(", ");
    let missing = format!("write a table with the columns {list}; {advice}");
    let is_name = |cell: &str| names.iter().any(|name| is_named(cell, name));
    let table = TableText::with_names(path, &missing, &is_name)?;
    let columns = names.iter().map(|name| table.column(name, &list)).collect::<Result<Vec<usize>>>()?;
    table.check_rows(GROWING * size_of::<T>())?;
    let rows = table.rows().map(|row| {
        let row = row?;
        let mut fields = [TextField { text: "", column: 1 }; N];
        for (k, field) in fields.iter_mut().enumerate() {
            *field = row.cell((columns[k], names[k]), advice)?;
        }
        read(&TextRow { path, line: row.line, has_decimal_commas: row.has_decimal_commas, fields })
    });
    let rows = rows.collect::<Result<Vec<T>>>()?;
    if rows.is_empty() { Err(Error::input(path, format!("has a header but no row; {advice}"))) } else { Ok(rows) }
}

/// Returns whether a cell of a header is `name`, in either case, with or without a unit.
pub(crate) fn is_named(cell: &str, name: &str) -> bool {
    split_unit(cell).0.eq_ignore_ascii_case(name)
}

/// Returns the content of a gzip file. Returns an error for a damaged file, or one that expands beyond [`MAX_EXPANDED`].
fn expand(path: &Path, bytes: &[u8]) -> Result<Vec<u8>> {
    let refuse = |problem: String| Error::input(path, problem);
    let damaged = |e: io::Error| refuse(format!("cannot be expanded: {e}; compress the table again"));
    let content = || MultiGzDecoder::new(bytes).take(MAX_EXPANDED + 1);
    // Counted first, so that nothing is held of a file that expands too far.
    let size = io::copy(&mut content(), &mut io::sink()).map_err(damaged)?;
    if size > MAX_EXPANDED {
        return Err(refuse(format!("expands beyond the limit of {MAX_EXPANDED} bytes; {SPLIT_ADVICE}")));
    }
    // Twice: its text may be converted, as that of [`MAX_TABLE`].
    check_memory(2 * size, SPLIT_ADVICE).map_err(refuse)?;
    let mut expanded = Vec::with_capacity(size as usize);
    content().read_to_end(&mut expanded).map_err(damaged)?;
    Ok(expanded)
}

/// Returns a line without the mark of a comment, which includes the `%` of MATLAB.
fn strip_comment_mark(line: &str) -> &str {
    line.trim_start_matches(['#', '/', ' ', '%'])
}

/// Splits a line at a mark outside quotes, or at blanks, into fields without surrounding blanks and quotes; stops after
/// [`MOST_FIELDS`].
fn split(line: &str, mark: Option<char>) -> impl Iterator<Item = &str> {
    let mut is_quoted = false;
    let parts = line.split(move |c: char| {
        is_quoted ^= c == '"' && mark.is_some();
        mark.map_or(c.is_whitespace(), |mark| c == mark && !is_quoted)
    });
    parts.filter(move |part| mark.is_some() || !part.is_empty()).take(MOST_FIELDS).map(unquoted)
}

/// Returns a field without surrounding blanks and quotes.
fn unquoted(part: &str) -> &str {
    let text = part.trim();
    text.strip_prefix('"').and_then(|text| text.strip_suffix('"')).unwrap_or(text).trim()
}

/// Returns whether all cells of column `k` are numbers or empty, with at least one number.
fn has_numbers(rows: &[Vec<&str>], k: usize, is_number: &dyn Fn(&str) -> bool) -> bool {
    let cells = rows.iter().filter_map(|row| row.get(k).copied());
    let mut values = cells.filter(|cell| !is_empty_cell(cell)).peekable();
    values.peek().is_some() && values.all(is_number)
}

/// Returns the separator (`None`: blanks) by which most of the first lines have an equal number of fields, at least two, and
/// that number; a comma and one field if there is none. In a tie, it splits the most lines, or is the first of [`MARKS`].
fn detect_separator(text: &str) -> (Option<char>, usize) {
    let lines: Vec<&str> =
        numbered_lines(text).map(|(_, line)| line).filter(|line| !is_comment(line)).take(EXAMINED).collect();
    let measured = MARKS.map(|mark| {
        let mut counts: BTreeMap<usize, usize> = BTreeMap::new();
        lines.iter().for_each(|line| *counts.entry(split(line, mark).count()).or_default() += 1);
        let split_lines: usize = counts.range(2..).map(|(_, n)| n).sum();
        let (width, n) =
            counts.into_iter().skip_while(|(width, _)| *width < 2).max_by_key(|(width, n)| (*n, Reverse(*width)))?;
        Some(((n, split_lines), mark, width))
    });
    let best = measured.into_iter().flatten().reduce(|best, other| if other.0 > best.0 { other } else { best });
    best.map_or((Some(','), 1), |(_, mark, width)| (mark, width))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn progress_ends_at_the_last_line() {
        use std::sync::atomic::{AtomicBool, Ordering};
        let text = format!("x,y,z\n{}", "1,2,3\n\n".repeat(300));
        let file = TableFile { path: "a.csv".into(), bytes: Some(text.into_bytes()) };
        let table = TableText::read(&file).unwrap();
        let is_beyond = AtomicBool::new(false);
        let progress = |line: usize, total: usize| _ = is_beyond.fetch_or(line > total, Ordering::Relaxed);
        assert_eq!(table.counted_rows(&progress).flatten().count(), 300);
        assert!(!is_beyond.load(Ordering::Relaxed));
    }

    #[test]
    fn split_fields_have_their_columns() {
        let fields = |line| locate_fields(line, split(line, Some(','))).into_iter().map(|f| (f.text, f.column));
        let got: Vec<_> = fields(" a, \"b,c\" ,,é,d").collect();
        assert_eq!(got, [("a", 2), ("b,c", 6), ("", 12), ("é", 13), ("d", 15)]);
        assert_eq!(fields(&"é, ".repeat(500_000)).next_back(), Some(("", 3 * 500_000)), "a long line");
        assert_eq!(split(&",".repeat(2_000_000), Some(',')).count(), MOST_FIELDS);
        let blanks = "1  2\t3";
        let got: Vec<_> = locate_fields(blanks, split(blanks, None)).iter().map(|f| (f.text, f.column)).collect();
        assert_eq!(got, [("1", 1), ("2", 4), ("3", 6)]);
    }

    /// Every reader of a table reads every dialect, and reports the line and column of an error in it.
    #[test]
    fn readers_of_tables_read_all_dialects() {
        let folder = tempfile::tempdir().unwrap();
        let name = |name: &str, bytes: &[u8]| {
            std::fs::write(folder.path().join(name), bytes).unwrap();
            folder.path().join(name)
        };
        let points = "x,y,z\n1.5,2.25,3\n4,5.25,6\n";
        let poses = "qx,qy,qz,qw,x,y,z\n0,0,0,1,1.5,2.25,3\n0.6,0,0,0.8,4,5.25,6\n";
        let powers = "101,a b\n-60.5,\n-71.25,-80\n";
        let dialects: [fn(&str) -> String; 8] = [
            |text| format!("\u{feff}{text}"),
            |text| text.replace('\n', "\r"),
            |text| text.replace('\n', "\r\n"),
            |text| text.replace(',', ";").replace('.', ","),
            |text| text.replace(',', "\t").replace('.', ","),
            |text| format!("# survey, 2024\n\n// of hall 2\n{}# end\n", text.replace('\n', "\n\n")),
            |text| format!("#{text}"),
            |text| text.replace(',', " | "),
        ];
        let receivers = ["101".to_owned(), "a b".into(), "other".into()];
        for (k, dialect) in dialects.iter().enumerate() {
            let read = |text: &str| name("a.csv", dialect(text).as_bytes());
            let expected = [[1.5, 2.25, 3.0], [4.0, 5.25, 6.0]];
            assert_eq!(crate::read_transmitters(&read(points)).unwrap(), expected, "{k}");
            assert_eq!(crate::read_points(&read(points)).unwrap(), expected, "{k}");
            let read_poses = crate::read_poses(&read(poses)).unwrap();
            assert_eq!((read_poses[0].position, read_poses[1].orientation), (expected[0], [0.6, 0.0, 0.0, 0.8]), "{k}");
            let rows = crate::read_powers(&read(powers), &receivers).unwrap();
            assert_eq!((rows[0][0], rows[1][..2].to_vec()), (-60.5, vec![-71.25, -80.0]), "{k}");
            assert!(rows[0][1].is_nan() && rows[1][2].is_nan(), "{k}");
            let error = crate::read_transmitters(&read(&points.replace("5.25", "5.2x"))).unwrap_err().to_string();
            let line = [3, 3, 3, 3, 3, 8, 3, 3][k];
            let column = if k == 7 { 5 } else { 3 };
            assert!(
                error.contains(&format!(
                    "a.csv:{line}:{column}: `5{}2x` is not",
                    [".", ","][usize::from(k == 3 || k == 4)]
                )),
                "{error}"
            );
        }
        let table = name("blanks.txt", b"x y z\n1 2  3\n4 5 6\n");
        assert_eq!(crate::read_transmitters(&table).unwrap(), crate::read_points(&table).unwrap());
        let mut gzip = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
        std::io::Write::write_all(&mut gzip, points.as_bytes()).unwrap();
        assert_eq!(crate::read_transmitters(&name("a.csv", &gzip.finish().unwrap())).unwrap().len(), 2);
        let latin = name("latin.csv", b"\"z\xfcrich\";x;y;z\n\xfc;1,5;2;3\n");
        assert_eq!(crate::read_transmitters(&latin).unwrap(), [[1.5, 2.0, 3.0]]);
        let marked = b"\xef\xbb\xbfz\xfcrich";
        for bytes in [Cow::Borrowed(&marked[..]), Cow::Owned(marked.to_vec())] {
            assert_eq!(TableText::decode(Path::new("a.csv"), bytes).unwrap().text, "zürich");
        }
    }
}
