//! Reads the series that a training writes (`journal.rs`): CSV files whose first field is the step.

use crate::text::damaged;
use pwrfgs_core::Result;
use pwrfgs_core::files::{self, read_text};
use std::path::Path;

/// Reads a series that is complete: rows of ascending steps, each whole, up to step `last`.
///
/// # Errors
/// [`pwrfgs_core::Error::Read`], or [`pwrfgs_core::Error::Input`] with the place where it is not as it was written.
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
}
