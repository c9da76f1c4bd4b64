//! Where the transmitters stand: one position on the command line, or a CSV file of them.

use crate::args::numbers;
use pwrfgs_core::origin::{coordinate_fault, place_fault};
use pwrfgs_core::{Error, Result, files};
use std::path::Path;

/// `x,y,z` of the command line, the value of `option`.
pub(in crate::commands) fn position(option: &str, text: &str) -> Result<[f64; 3]> {
    let wrong = || {
        Error::Config(format!(
            "{option} {text}: give three finite numbers of at most 1e8 in metres, such as 3.5,2.2,1.2"
        ))
    };
    numbers(text).filter(|place| place_fault(*place).is_none()).ok_or_else(wrong)
}

/// Columns x, y, z of a CSV file.
pub(in crate::commands) fn positions(path: &Path) -> Result<Vec<[f64; 3]>> {
    let text = files::read_at_most(path, files::MAX_TEXT).map_err(|e| Error::read(path, e))?;
    let text = text.strip_prefix("\u{feff}".as_bytes()).unwrap_or(&text);
    let mut reader = csv::ReaderBuilder::new().flexible(true).trim(csv::Trim::All).from_reader(text);
    let broken = |e: csv::Error| {
        let line = e.position().map_or(1, csv::Position::line) as usize;
        Error::at(path, line, 1, format!("this is not CSV text: {e}"))
    };
    let headers = reader.headers().map_err(broken)?.clone();
    let mut columns = [0; 3];
    for (column, name) in columns.iter_mut().zip(["x", "y", "z"]) {
        *column = headers.iter().position(|h| h.eq_ignore_ascii_case(name)).ok_or_else(|| {
            let found = headers.iter().collect::<Vec<_>>().join(",");
            Error::at(path, 1, 1, format!("no column `{name}` in `{found}`; the first line must name x, y and z"))
        })?;
    }
    let mut txs = Vec::new();
    for record in reader.records() {
        let record = record.map_err(broken)?;
        let line = record.position().map_or(1, csv::Position::line) as usize;
        let mut tx = [0.0; 3];
        for (value, &column) in tx.iter_mut().zip(&columns) {
            let field = record.get(column).ok_or_else(|| {
                let (has, needs) = (record.len(), headers.len());
                Error::at(path, line, 1, format!("this row has {has} fields and the first line names {needs}"))
            })?;
            *value = field.parse().ok().filter(|v| coordinate_fault(*v).is_none()).ok_or_else(|| {
                let what =
                    format!("`{field}` in column `{}` is no finite number of metres, 1e8 at most", &headers[column]);
                Error::at(path, line, column + 1, what)
            })?;
        }
        txs.push(tx);
    }
    if txs.is_empty() {
        return Err(Error::input(path, "there is no row; give one position a line"));
    }
    Ok(txs)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn positions_are_three_finite_numbers() {
        assert_eq!(position("--tx", "1, -2.5,3e0").unwrap(), [1.0, -2.5, 3.0]);
        for wrong in ["", "1,2", "1,2,3,4", "1,2,x", "1,2,NaN", "1,inf,2", "1,2,1e9"] {
            assert!(position("--tx", wrong).unwrap_err().is_input(), "{wrong}");
        }
    }
}
