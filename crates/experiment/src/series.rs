//! `Series`: a CSV file that grows with the training and is cut back to the checkpoint when a run goes on.

use crate::text::damaged;
use pwrfgs_core::files::{self, read_text, write_atomically};
use pwrfgs_core::{Error, Result};
use std::fs::{File, OpenOptions};
use std::io::Write as _;
use std::path::{Path, PathBuf};

/// An open series; the first field of each row is the step.
#[derive(Debug)]
pub(crate) struct Series {
    path: PathBuf,
    file: File,
}

impl Series {
    /// Opens `path`, keeping the rows up to step `done`; returns the last of them. What follows them is dropped: rows of
    /// later steps, and what a killed run or a lost machine left half-written.
    ///
    /// # Errors
    /// Where a row before the last kept one, or the header, is damaged: it would be lost without a word.
    pub(crate) fn open(path: &Path, header: &str, done: u64) -> Result<(Self, Option<String>)> {
        let old = files::if_found(path, files::read(path))?.unwrap_or_default();
        let old = String::from_utf8_lossy(&old);
        let mut text = format!("{header}\n");
        let (mut last, mut broken) = (None, None);
        let damaged = |line: usize, what: &str| {
            Error::at(path, line, 1, format!("{what}; put the file right, or remove it to go on without its rows"))
        };
        let mut lines = old.split_inclusive('\n').zip(1..);
        if done > 0 && lines.next().is_some_and(|(first, _)| first != text) {
            return Err(damaged(1, &format!("the first line is not `{header}`")));
        }
        for (line, place) in lines {
            match line.split(',').next().and_then(|step| step.parse::<u64>().ok()) {
                Some(step) if step <= done && line.ends_with('\n') => {
                    if let Some(place) = broken {
                        return Err(damaged(place, "this row begins with no step, and rows follow"));
                    }
                    text.push_str(line);
                    last = Some(line.trim_end().to_owned());
                }
                Some(_) => {}
                None => broken = broken.or(Some(place)),
            }
        }
        write_atomically(path, text.as_bytes())?;
        let file = OpenOptions::new().append(true).open(path).map_err(|e| Error::write(path, e))?;
        Ok((Self { path: path.into(), file }, last))
    }

    /// Appends one row.
    pub(crate) fn push(&mut self, row: &str) -> Result<()> {
        self.file.write_all(format!("{row}\n").as_bytes()).map_err(|e| Error::write(&self.path, e))
    }

    /// Brings the rows to the disk; called before each checkpoint, which must never know more than the series.
    pub(crate) fn sync(&self) -> Result<()> {
        self.file.sync_data().map_err(|e| Error::write(&self.path, e))
    }
}

/// Reads a series that is complete: rows of ascending steps, each whole, up to step `last`.
///
/// # Errors
/// [`Error::Read`], or [`Error::Input`] with the place where it is not as it was written.
pub fn whole(path: &Path, last: u64) -> Result<Vec<Vec<Option<f64>>>> {
    let text = read_text(path)?;
    let wrong = |line: usize, what: &str| Err(damaged(path, line, what));
    let names: Vec<&str> = text.lines().next().unwrap_or_default().split(',').collect();
    if !text.ends_with('\n') || names[0] != "step" {
        return wrong(text.lines().count().max(1), "the file ends before the end of a row, or begins without names");
    }
    let mut rows = Vec::new();
    let mut done = 0;
    for (k, line) in text.lines().enumerate().skip(1) {
        let row: Vec<Option<f64>> = line.split(',').map(|field| field.parse().ok()).collect();
        // Names of phases are the only words.
        let is_whole =
            row.len() == names.len() && row.iter().zip(&names).all(|(v, name)| v.is_some() || *name == "phase");
        match line.split(',').next().and_then(|step| step.parse::<u64>().ok()) {
            Some(step) if is_whole && step > done => done = step,
            _ => return wrong(k + 1, "this row is not one that the run wrote"),
        }
        rows.push(row);
    }
    if done != last {
        return wrong(rows.len() + 1, &format!("the last row is of step {done} instead of {last}"));
    }
    Ok(rows)
}

/// Step and another column of the rows where both are numbers.
pub fn column(rows: &[Vec<Option<f64>>], column: usize) -> Vec<(f64, f64)> {
    rows.iter().filter_map(|row| Some(((*row.first()?)?, (*row.get(column)?)?))).collect()
}

/// Reads the rows of a series as numbers, `None` for fields that are none; nothing where there is no such file.
pub fn read(path: &Path) -> Vec<Vec<Option<f64>>> {
    let Ok(text) = files::read_string(path) else { return Vec::new() };
    text.lines().skip(1).map(|line| line.split(',').map(|field| field.parse().ok()).collect()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_series_is_cut_back_to_the_checkpoint() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("curve.csv");
        let (mut series, last) = Series::open(&path, "step,loss", 0).unwrap();
        assert_eq!(last, None);
        for row in ["10,0.5", "20,0.4", "30,0.3"] {
            series.push(row).unwrap();
        }
        series.file.write_all(b"40,0.").unwrap();
        let (mut series, last) = Series::open(&path, "step,loss", 20).unwrap();
        assert_eq!(last.as_deref(), Some("20,0.4"));
        series.push("30,0.3").unwrap();
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "step,loss\n10,0.5\n20,0.4\n30,0.3\n");
        assert_eq!(read(&path)[2], vec![Some(30.0), Some(0.3)]);
        assert_eq!(whole(&path, 30).unwrap(), read(&path));
    }

    #[test]
    fn a_damaged_series_is_told() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("curve.csv");
        let wrong = [
            ("", ":1:1: the file ends"),
            ("step,phase,loss\n", ":1:1: the last row is of step 0 instead of 20"),
            ("step,phase,loss\n10,densify,0.5\n", ":2:1: the last row is of step 10"),
            ("step,phase,loss\n10,densify,0.5\n20,prune,0.", ":3:1: the file ends"),
            ("step,phase,loss\n10,densify\n20,prune,0.4\n", ":2:1: this row"),
            ("step,phase,loss\n10,densify,x\n20,prune,0.4\n", ":2:1: this row"),
            ("step,phase,loss\n10,densify,0.5\n10,densify,0.5\n20,prune,0.4\n", ":3:1: this row"),
        ];
        for (text, why) in wrong {
            std::fs::write(&path, text).unwrap();
            let said = whole(&path, 20).unwrap_err();
            assert!(said.is_input() && said.to_string().contains(why), "{said}");
        }
        std::fs::write(&path, "step,phase,loss\n10,densify,NaN\n20,prune,inf\n").unwrap();
        assert_eq!(whole(&path, 20).unwrap().len(), 2);
        assert!(whole(&folder.path().join("missing.csv"), 20).unwrap_err().is_input());
    }

    #[test]
    fn a_damaged_row_is_told_unless_it_comes_after_all_that_are_kept() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("curve.csv");
        let open = |text: &[u8], done| {
            std::fs::write(&path, text).unwrap();
            Series::open(&path, "step,loss", done).map(|(_, last)| last).map_err(|e| e.to_string())
        };
        assert_eq!(open(b"step,loss\n10,0.5\n\0\xff\0\n", 20), Ok(Some("10,0.5".into())));
        assert_eq!(open(b"stop,loss\n10,0.5\n", 0), Ok(None), "nothing is kept");
        let said = open(b"step,loss\n1\xff0,0.5\n20,0.4\n", 20).unwrap_err();
        assert!(said.contains("curve.csv:2:1: this row begins with no step"), "{said}");
        let said = open(b"stop,loss\n10,0.5\n", 20).unwrap_err();
        assert!(said.contains("curve.csv:1:1: the first line is not `step,loss`; put the file right"), "{said}");
    }
}
