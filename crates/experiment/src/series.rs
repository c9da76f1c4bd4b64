//! `Series`: a CSV file that grows with the training and is cut back to the checkpoint when a run goes on.

use pwrfgs_core::files::{self, write_atomically};
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
    /// Opens `path`, keeping the complete rows up to step `done`; returns the last of them. A row that a killed run
    /// left half-written is dropped, and so is a file with another header.
    pub(crate) fn open(path: &Path, header: &str, done: u64) -> Result<(Self, Option<String>)> {
        let old = match files::read_string(path) {
            Ok(text) => text,
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => String::new(),
            Err(e) => return Err(Error::read(path, e)),
        };
        let mut text = format!("{header}\n");
        let mut last = None;
        let mut lines = old.split_inclusive('\n');
        if lines.next() == Some(text.as_str()) {
            for line in lines.filter(|l| l.ends_with('\n')) {
                if line.split(',').next().and_then(|s| s.parse::<u64>().ok()).is_some_and(|step| step <= done) {
                    text.push_str(line);
                    last = Some(line.trim_end().to_owned());
                }
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
    }
}
