//! `freq.txt`: the carrier of every sample.

use crate::text::{number, read_text, split_blanks};
use pwrfgs_core::{Error, Result, carrier_fault, files::MAX_TEXT};
use std::path::Path;

/// File of the carriers.
pub const CARRIERS: &str = "freq.txt";
/// Smallest number that is in Hz; smaller ones are in GHz.
const LEAST_HZ: f64 = 1e6;

/// Reads `freq.txt` in the folder `root`: the carrier of row k of `table` in line k, Hz. `None` without the file.
///
/// # Errors
/// Those of [`read_carriers`], or another number of lines than `rows`.
pub(crate) fn read(root: &Path, table: &str, rows: usize) -> Result<Option<Vec<f64>>> {
    let path = root.join(CARRIERS);
    if !path.exists() {
        return Ok(None);
    }
    let all = read_carriers(&path)?;
    if all.len() != rows {
        let what = format!("has {} lines, but {table} has {rows} rows; write one line per row", all.len());
        return Err(Error::input(&path, what));
    }
    Ok(Some(all))
}

/// Reads one carrier per line, Hz: numbers are in GHz, and from 1e6 in Hz.
///
/// # Errors
/// A line without one valid carrier, with line and column.
pub fn read_carriers(path: &Path) -> Result<Vec<f64>> {
    let advice = "write the carrier of one sample per line, in GHz, such as 2.4";
    let text = read_text(path, MAX_TEXT, advice)?;
    let carrier = |(i, content): (usize, &str)| {
        let fields = split_blanks(content);
        let [field] = fields[..] else {
            let what = format!("{} numbers, expected 1; {advice}", fields.len());
            return Err(Error::at(path, i + 1, 1, what));
        };
        let column = field.column;
        let value = number(path, i + 1, field, advice)?;
        let hz = if value < LEAST_HZ { (value * 1e9).round() } else { value };
        carrier_fault(hz).map_or(Ok(hz), |fault| Err(Error::at(path, i + 1, column, format!("{fault}, or in GHz"))))
    };
    text.trim_end().lines().enumerate().map(carrier).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read_str(text: &str, rows: usize) -> Result<Option<Vec<f64>>, String> {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join(CARRIERS), text).unwrap();
        let shown = |e: Error| e.to_string().replace(&folder.path().display().to_string(), "DIR");
        read(folder.path(), "tx_pos.csv", rows).map_err(shown)
    }

    #[test]
    fn reads_gigahertz_and_hertz() {
        assert_eq!(read_str("1\r\n2.412\n24.25\n928e6\n\n", 4).unwrap().unwrap(), [1e9, 2.412e9, 24.25e9, 928e6]);
        assert_eq!(read(Path::new("/none"), "tx_pos.csv", 4).unwrap(), None);
    }

    #[test]
    fn reports_line_and_next_step() {
        let advice = "write the carrier of one sample per line, in GHz, such as 2.4";
        let cases = [
            ("2.4\nabc\n", format!("DIR/freq.txt:2:1: `abc` is not a number; {advice}")),
            ("2.4\n\n2.4\n", format!("DIR/freq.txt:2:1: 0 numbers, expected 1; {advice}")),
            ("2.4 2.5\n", format!("DIR/freq.txt:1:1: 2 numbers, expected 1; {advice}")),
            ("inf\n", format!("DIR/freq.txt:1:1: `inf` is not finite; {advice}")),
            (
                "2.4\n -1\n",
                "DIR/freq.txt:2:2: the carrier is -1000000000.0 Hz; give a frequency between 1e6 and 1e12 Hz, or in GHz".into(),
            ),
            ("2.4\n", "DIR/freq.txt: has 1 lines, but tx_pos.csv has 2 rows; write one line per row".into()),
            ("", "DIR/freq.txt: has 0 lines, but tx_pos.csv has 2 rows; write one line per row".into()),
        ];
        for (text, message) in cases {
            let shown = read_str(text, 2).unwrap_err();
            assert!(shown.contains(&message), "{shown}");
        }
    }
}
