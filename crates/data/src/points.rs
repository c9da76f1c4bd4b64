//! Point clouds: PLY, plain XYZ (blanks between numbers) and CSV; coordinates in metres, world frame.

use crate::ply;
use crate::text::{POINT_ADVICE, XyzColumns, lines, no_longer, read_bytes, read_text, split_blanks, split_commas};
use pwrfgs_core::{Error, Result, files::MAX_NUMBERS};
use std::path::Path;

const ADVICE: &str = "check the path of the point cloud";

/// Reads the points `[P,3]` of a file, which holds at least one.
///
/// * `.ply`: ascii or binary of either byte order; `x`, `y` and `z` anywhere among the properties of `vertex`.
/// * `.xyz`, `.txt`: x y z and anything else, a point a line; lines that start with `#` or `//` are left out.
/// * `.csv`: the same between commas, or with a header that names x, y and z in any order.
///
/// # Errors
/// Names the file, and line and column in text: truncated, empty, not a number, not finite, beyond 1e8 m, unknown extension.
pub fn read_points(path: &Path) -> Result<Vec<[f64; 3]>> {
    let extension = path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
    let points = match extension.as_str() {
        "ply" => ply::parse(path, &read_bytes(path, MAX_NUMBERS, ADVICE)?)?,
        "xyz" | "txt" => parse_xyz(path, &read_text(path, MAX_NUMBERS, ADVICE)?)?,
        "csv" => parse_csv(path, &read_text(path, MAX_NUMBERS, ADVICE)?)?,
        _ => return Err(Error::input(path, "is no point cloud by its extension; use .ply, .xyz or .csv")),
    };
    if points.is_empty() {
        return Err(Error::input(path, "holds no point; give at least one, or leave `points` out"));
    }
    Ok(points)
}

fn parse_xyz(path: &Path, text: &str) -> Result<Vec<[f64; 3]>> {
    let is_comment = |row: &str| row.starts_with('#') || row.starts_with("//");
    lines(text)
        .filter(|(_, row)| !is_comment(row.trim_start()))
        .map(|(line, row)| XyzColumns([0, 1, 2]).read(path, line, &split_blanks(row), POINT_ADVICE))
        .collect()
}

fn parse_csv(path: &Path, text: &str) -> Result<Vec<[f64; 3]>> {
    let mut rows = lines(text).peekable();
    let (mut columns, mut header) = (XyzColumns([0, 1, 2]), usize::MAX);
    if let Some(&(line, first)) = rows.peek() {
        let fields = split_commas(first);
        if fields.iter().all(|f| f.text.parse::<f64>().is_err()) {
            columns = XyzColumns::from_header(path, line, &fields)?;
            header = fields.len();
            rows.next();
        }
    }
    let read = |(line, row)| {
        let row = split_commas(row);
        no_longer(path, line, &row, header)?;
        columns.read(path, line, &row, POINT_ADVICE)
    };
    rows.map(read).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(name: &str, bytes: &[u8]) -> Result<Vec<[f64; 3]>, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        read_points(&path).map_err(|e| e.to_string().replace(&folder.path().display().to_string(), "DIR"))
    }

    #[test]
    fn xyz_and_csv_say_the_same() {
        let points = vec![[1.0, -2.0, 0.5], [0.0, 1e-3, 3.0]];
        assert_eq!(read("a.xyz", b"# room\n1 -2 0.5 255 0 0\n\n0\t1e-3 3\n").unwrap(), points);
        assert_eq!(read("a.csv", b"1,-2,0.5\r\n0,1e-3,3,extra\r\n").unwrap(), points);
        assert_eq!(read("a.CSV", b"\"z\",name,X,y\n0.5,\"a,b\",1,-2\n3,c,0,1e-3\n").unwrap(), points);
    }

    #[test]
    fn mistakes_in_text_are_told_with_their_place() {
        let advice = POINT_ADVICE;
        let cases: [(&str, &[u8], String); 11] = [
            ("a.csv", b"x,y,z,X\n1,2,3,4\n", "DIR/a.csv:1:7: a second column `x`; name each of x, y and z once".into()),
            (
                "a.csv",
                b"x,y,z\n1,2,3,,\n1,5,2,3\n",
                "DIR/a.csv:3:7: the row has 4 fields, its header 3; write decimals with a point, and one value a column".into(),
            ),
            ("a.xyz", b"1 2 3\n-1e30 2 3\n", format!("DIR/a.xyz:2:1: `-1e30` is beyond 1e8 m; {advice}")),
            (
                "a.xyz",
                b"1 2 3\n1 2\n",
                format!("DIR/a.xyz:2:4: the row ends after 2 of the 3 columns that `z` needs; {advice}"),
            ),
            ("a.xyz", b"1 2 nan\n", format!("DIR/a.xyz:1:5: `nan` is not finite; {advice}")),
            ("a.csv", b"x,y,z\n1,inf,2\n", format!("DIR/a.csv:2:3: `inf` is not finite; {advice}")),
            ("a.csv", b"1,2,3\n1,two,3\n", format!("DIR/a.csv:2:3: `two` is not a number; {advice}")),
            (
                "a.csv",
                b"x,y\n1,2\n",
                "DIR/a.csv:1:1: no column `z`; the first line must name the columns x, y and z".into(),
            ),
            ("a.csv", b"x,y,z\n", "DIR/a.csv: holds no point; give at least one, or leave `points` out".into()),
            ("a.xyz", b"", "DIR/a.xyz: holds no point; give at least one, or leave `points` out".into()),
            ("a.las", b"", "DIR/a.las: is no point cloud by its extension; use .ply, .xyz or .csv".into()),
        ];
        for (name, bytes, message) in cases {
            assert_eq!(read(name, bytes).unwrap_err(), message);
        }
        let missing = read_points(Path::new("no/such.ply")).unwrap_err();
        assert_eq!(missing.to_string(), "cannot read no/such.ply: no such file; check the path of the point cloud");
    }
}
