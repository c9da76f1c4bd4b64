//! `train_index.txt` and `test_index.txt`: sample ids of each set, one per line, zero-padded or not.

use crate::text::{TextRow, is_comment, numbered_lines, read_text};
use pwrfgs_core::{Error, Result, files::MAX_TEXT, messages::quoted};
use std::{
    collections::{BTreeMap, BTreeSet},
    path::Path,
};

/// Word of an index file.
pub(crate) struct IndexEntry {
    pub(crate) id: u32,
    /// Sample index.
    pub(crate) sample: usize,
}

/// Function that parses a word of an index file; returns the problem if the word is invalid.
pub(crate) type ParseEntry<'a> = dyn Fn(&str) -> Result<IndexEntry, String> + 'a;

/// Ids of spectra, which count from 1.
pub(crate) struct SpectrumIds<'a> {
    /// File of the transmitters.
    pub(crate) table: &'a str,
    /// Number of its rows; valid ids are 1 to this.
    pub(crate) rows: usize,
    /// Ids that have an image.
    pub(crate) images: &'a BTreeSet<u32>,
    /// Ids that have a row and an image, sorted: the samples.
    pub(crate) samples: &'a [u32],
}

impl SpectrumIds<'_> {
    /// Parses the id of a sample. Returns the problem with an id that has no row or no image.
    pub(crate) fn parse_id(&self, word: &str) -> Result<IndexEntry, String> {
        let table = self.table;
        let id = match word.parse() {
            Ok(0) => {
                let advice = "if both index files count from 0, add 1 to each number";
                return Err(format!("invalid id 0; ids count from 1, the first row of {table}; {advice}"));
            }
            Ok(id) => id,
            Err(_) => return Err(format!("{} is not a sample id; write one per line, such as 00001", quoted(word))),
        };
        if id as usize > self.rows {
            let rows = self.rows;
            return Err(format!("id {id} has no row in {table}, which has {rows}; add the row or remove the id"));
        }
        if !self.images.contains(&id) {
            return Err(format!("id {id} has no image spectrum/{id:05}.png; add the image or remove the id"));
        }
        let sample = self.samples.binary_search(&id).expect("an id with a row and an image is a sample");
        Ok(IndexEntry { id, sample })
    }
}

/// Parses a row number of `table`, counted from 0 as ids of powers and channels are. Returns the problem with a number that
/// is not below `rows`.
pub(crate) fn parse_row(word: &str, table: &str, rows: usize) -> Result<IndexEntry, String> {
    match word.parse::<u32>() {
        Ok(id) if (id as usize) < rows => Ok(IndexEntry { id, sample: id as usize }),
        Ok(id) => {
            let advice = if id as usize == rows {
                "if both index files count from 1, subtract 1 from each number"
            } else {
                "remove the number"
            };
            Err(format!("invalid row {id} of {table}, which has {rows} rows counted from 0; {advice}"))
        }
        Err(_) => Err(format!("{} is not a row of {table}; write one per line, counted from 0", quoted(word))),
    }
}

/// Reads both index files in the folder `root` as sample indices (training, test), each sorted; `None` if neither exists.
/// Returns an error if one is missing, has an invalid word or is empty, or if an id occurs twice.
pub(crate) fn read_sets(root: &Path, parse: &ParseEntry<'_>) -> Result<Option<(Vec<usize>, Vec<usize>)>> {
    let [train, test] = ["train_index.txt", "test_index.txt"].map(|name| root.join(name));
    match (train.exists(), test.exists()) {
        (false, false) => Ok(None),
        (true, true) => {
            let mut seen = BTreeMap::new();
            let train = read_list(&train, parse, &mut seen)?;
            Ok(Some((train, read_list(&test, parse, &mut seen)?)))
        }
        (has_train, _) => {
            let (present, missing) = if has_train { (train, "test_index.txt") } else { (test, "train_index.txt") };
            let advice = "give both or neither (then use a split such as Random())";
            Err(Error::input(&present, format!("this file comes without {missing}; {advice}")))
        }
    }
}

/// Reads one index file as sample indices, sorted, and adds its ids to `seen`, which maps each to the file and line that
/// lists it. Returns an error for an invalid word, an id that was seen before, or a file without ids.
fn read_list(path: &Path, parse: &ParseEntry<'_>, seen: &mut BTreeMap<u32, String>) -> Result<Vec<usize>> {
    let text = read_text(path, MAX_TEXT, "give both index files or neither")?;
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let mut list = Vec::new();
    for line in numbered_lines(&text).filter(|(_, line)| !is_comment(line)) {
        let row = TextRow::split(path, line, |c| c.is_whitespace() || c == ',' || c == ';');
        for field in &row.fields {
            let IndexEntry { id, sample } = parse(field.text).map_err(|fault| row.fault(field.column, fault))?;
            list.push(sample);
            if let Some(before) = seen.insert(id, format!("{name}, line {}", row.line)) {
                let problem = format!("id {id} was already named in {before}");
                let advice = "a sample belongs to one set: remove one of the two";
                return Err(row.fault(field.column, format!("{problem}; {advice}")));
            }
        }
    }
    if list.is_empty() {
        return Err(Error::input(path, "names no sample; list at least one id, or remove both index files"));
    }
    list.sort_unstable();
    Ok(list)
}
