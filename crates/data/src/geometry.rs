//! Point clouds (PLY, XYZ, CSV) and triangle meshes (OBJ, PLY); coordinates in metres, world frame, unless the reader's
//! caller scales them.
//!
//! The parsers are our own, because a mesh that is read wrongly is a wrong room. Alternatives tested: `tobj` 4.0.5
//! panics on a texture index out of range, makes a triangle of two corners and reads a web page as an empty mesh;
//! `mesh-loader` 0.1.13 rejects an OBJ file in which only some objects have textures. Neither reports line and column
//! of every error.

use crate::dialect::{GROWING, TableText, is_named};
use crate::ply;
use crate::polygons::{Polygons, Triangles};
use crate::text::{POINT_ADVICE, TextField, TextRow, VERTEX_ADVICE, XyzColumns, numbered_lines, read_bytes, warn_once};
use pwrfgs_core::files::{MAX_NUMBERS, MAX_TEXT};
use pwrfgs_core::messages::quoted;
use pwrfgs_core::{Error, Result};
use std::borrow::Cow;
use std::collections::BTreeSet;
use std::path::Path;

const MESH_ADVICE: &str = "check the path of the mesh";

/// Reads the surface of a mesh file; polygons are cut into triangles. Triangles without area and repeated corners are left
/// out, with a warning that counts them.
///
/// * `.obj`: `v` and `f`, with positive and negative indices; groups, normals, textures, materials, lines and points
///   are ignored, with a warning for several materials, and free-form surfaces are an error.
/// * `.ply`: ascii or binary of either byte order, with an element `face` or `tristrips` and its list `vertex_indices`.
///
/// # Errors
/// Reports the file, with line and column for text: truncated, not a number, not finite, an index out of range, a face
/// of fewer than three corners, a polygon with a hole or that crosses itself, more than
/// [`MOST_TRIANGLES`](crate::MOST_TRIANGLES), unknown extension. An OBJ file without faces is valid, as is
/// a PLY file with an empty element `face`.
pub fn read_mesh(path: &Path) -> Result<Triangles> {
    let parse = match lower_extension(path).as_str() {
        "obj" => parse_obj,
        "ply" => ply::parse_mesh,
        _ => return Err(Error::input(path, "unsupported mesh format; export it as .obj or .ply")),
    };
    parse(path, strip_byte_order_mark(&read_bytes(path, MAX_TEXT, MESH_ADVICE)?))
}

/// Returns the extension of a file in lower case; empty without one.
fn lower_extension(path: &Path) -> String {
    path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default()
}

/// Returns the content of a file without a byte order mark.
fn strip_byte_order_mark(bytes: &[u8]) -> &[u8] {
    bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes)
}

/// OBJ statements that do not describe the surface; they are ignored.
const IGNORED: &str = "vn vt vp o g s mg l p mtllib usemap maplib bevel c_interp d_interp lod shadow_obj trace_obj";

/// Parses the statements `v` and `f` of an OBJ file; polygons are cut into triangles. Returns an error with line and column
/// for an invalid statement.
fn parse_obj(path: &Path, bytes: &[u8]) -> Result<Triangles> {
    let text = String::from_utf8_lossy(bytes);
    let text = join_continued_lines(&text);
    let mut materials = BTreeSet::new();
    let rows =
        || numbered_lines(&text).map(|(line, content)| TextRow::split_at_blanks(path, (line, statement(content))));
    // A face may use a vertex defined after it.
    let count = rows().filter(|row| row.fields.first().is_some_and(|field| field.text == "v")).count();
    let (mut vertices, mut polygons) = (Vec::with_capacity(count), Polygons::default());
    for row in rows() {
        let Some(keyword) = row.fields.first() else { continue };
        match keyword.text {
            "v" => vertices.push(XyzColumns([1, 2, 3]).read(&row, VERTEX_ADVICE)?),
            "f" => {
                let index = |field: &TextField<'_>| parse_corner_index(&row, *field, vertices.len());
                let corners = row.fields[1..].iter().map(index).collect::<Result<Vec<i64>>>()?;
                polygons.push(&corners, count).map_err(|fault| row.fault(keyword.column, fault))?;
            }
            "usemtl" => _ = materials.insert(row.fields.get(1).map_or("", |field| field.text)),
            word if IGNORED.split(' ').any(|ignored| ignored == word) => {}
            word => {
                let problem = "is not a vertex or face statement; export triangles from the modelling program";
                return Err(row.fault(keyword.column, format!("{} {problem}", quoted(word))));
            }
        }
    }
    if materials.len() > 1 {
        let advice =
            "the whole mesh has the finish of its object; for one finish per material, split the mesh by material";
        warn_once(path, format_args!("{} materials (`usemtl`) are ignored; {advice}", materials.len()));
    }
    polygons.triangulate(path, vertices)
}

/// Returns the statement of an OBJ line, without its comment.
fn statement(line: &str) -> &str {
    line.split('#').next().unwrap_or_default()
}

/// Returns the text with each statement in one line: a backslash at the end continues it. Line numbers are kept.
fn join_continued_lines(text: &str) -> Cow<'_, str> {
    if !text.contains('\\') {
        return text.into();
    }
    let (mut joined, mut last) = (String::with_capacity(text.len()), 1);
    let mut is_continued = false;
    for (line, content) in numbered_lines(text) {
        if !is_continued {
            joined.extend(std::iter::repeat_n('\n', line - last));
            last = line;
        }
        let head = statement(content).trim_end().strip_suffix('\\');
        joined.push_str(head.unwrap_or(content));
        joined.push(' ');
        is_continued = head.is_some();
    }
    joined.into()
}

/// Parses the vertex index of a corner such as `3`, `-1`, `3/1` or `3//2`, and returns it counted from 0. A negative
/// index counts back from the last of the `so_far` vertices. Returns an error for 0 and for other text; the range is
/// not checked.
fn parse_corner_index(row: &TextRow<'_>, field: TextField<'_>, so_far: usize) -> Result<i64> {
    let mut parts = field.text.split('/');
    let index = parts.next().and_then(|text| text.parse::<i64>().ok()).filter(|&index| index != 0);
    // Optional texture and normal indices, nothing else.
    let is_whole = parts.clone().count() <= 2 && parts.all(|part| part.is_empty() || part.parse::<i64>().is_ok());
    let index = index.filter(|_| is_whole);
    let index = index.ok_or_else(|| {
        let problem = "is not a vertex index (1 and up, or -1 and down from the end); correct the index";
        row.fault(field.column, format!("{} {problem}", quoted(field.text)))
    })?;
    Ok(if index > 0 { index - 1 } else { index.saturating_add_unsigned(so_far as u64) })
}

const CLOUD_ADVICE: &str = "check the path of the point cloud";

/// Reads the points `[P,3]` of a file, which holds at least one.
///
/// * `.ply`: ascii or binary of either byte order; `x`, `y` and `z` anywhere among the properties of `vertex`.
/// * `.xyz`, `.txt`, `.csv`: x y z and further columns, one point per line, or with a header that names x, y and z in any
///   order, such as `//X,Y,Z` or `x [m]`. The first row may hold the number of points alone, as `CloudCompare` writes it.
///
/// # Errors
/// Reports the file, with line and column for text: truncated, empty, not a number, not finite, beyond 1e8 m, unknown
/// extension.
pub fn read_points(path: &Path) -> Result<Vec<[f64; 3]>> {
    let points = match lower_extension(path).as_str() {
        "ply" => ply::parse_points(path, strip_byte_order_mark(&read_bytes(path, MAX_NUMBERS, CLOUD_ADVICE)?))?,
        "xyz" | "txt" | "csv" => read_table_points(path)?,
        _ => return Err(Error::input(path, "unsupported point cloud format; use .ply, .xyz or .csv")),
    };
    if points.is_empty() {
        return Err(Error::input(path, "holds no point; give at least one, or leave `points` out"));
    }
    Ok(points)
}

/// Reads a point per row, below an optional header and an optional line with their number. Returns an error for an invalid
/// header, a row that is too short or too long, an invalid coordinate, or another number of points than announced.
fn read_table_points(path: &Path) -> Result<Vec<[f64; 3]>> {
    let is_name = |cell: &str| ["x", "y", "z"].iter().any(|name| is_named(cell, name));
    let table = TableText::with_names(path, CLOUD_ADVICE, &is_name)?;
    let column = |name| table.column(name, "x, y and z");
    let columns = if table.header.is_some() { [column("x")?, column("y")?, column("z")?] } else { [0, 1, 2] };
    table.check_rows(GROWING * size_of::<[f64; 3]>())?;
    let mut rows = table.rows().peekable();
    let lone = |row: &TextRow<'_>| if row.fields.len() == 1 { row.fields[0].text.parse::<usize>().ok() } else { None };
    let count = rows.peek().and_then(|row| row.as_ref().ok()).and_then(|row| Some((row.line, lone(row)?)));
    rows.next_if(|_| count.is_some());
    let points = rows.map(|row| XyzColumns(columns).read(&row?, POINT_ADVICE)).collect::<Result<Vec<_>>>()?;
    match count {
        Some((line, count)) if count != points.len() => {
            let problem = format!("announces {count} points, but {} follow; copy the file again", points.len());
            Err(Error::at(path, line, 1, problem))
        }
        _ => Ok(points),
    }
}

#[cfg(test)]
mod mesh_tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn file_format_follows_extension() {
        let folder = tempfile::tempdir().unwrap();
        let triangle: Triangles = (vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 0.1, 0.0]], vec![[0, 1, 2]]);
        let files = [
            ("a.OBJ", "v 0 0 0\nv 1 0 0\nv 0 .1 0\nf 1 2 3\n"),
            (
                "a.ply",
                "ply\nformat ascii 1.0\nelement vertex 3\nproperty double x\nproperty double y\nproperty double z\n\
                 element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 .1 0\n3 0 1 2\n",
            ),
        ];
        for (name, text) in files {
            let path = folder.path().join(name);
            std::fs::write(&path, text).unwrap();
            assert_eq!(read_mesh(&path).unwrap(), triangle, "{name}");
        }
        let message = |name: &str| read_mesh(Path::new(name)).unwrap_err().to_string();
        assert_eq!(message("a.step"), "a.step: unsupported mesh format; export it as .obj or .ply");
        assert_eq!(message("no/a.obj"), "cannot read no/a.obj: no such file; check the path of the mesh");
    }

    proptest! {
        /// Any bytes give triangles over existing vertices, or an error.
        #[test]
        fn random_bytes_never_panic(
            noise in prop::collection::vec(any::<u8>(), 0..300),
            words in "(v |f |-?[0-9]{1,20} |[0-9]/|nan |\\.|\n){0,60}",
            header in 0..2usize,
        ) {
            let ply = "ply\nformat binary_little_endian 1.0\nelement vertex 3\nproperty char x\nproperty char y\n\
                       property char z\nelement face 9\nproperty list char char vertex_indices\nend_header\n";
            let head = ["", ply][header];
            for body in [&noise[..], words.as_bytes()] {
                let bytes = [head.as_bytes(), body].concat();
                for parse in [parse_obj, ply::parse_mesh] {
                    if let Ok((vertices, triangles)) = parse(Path::new("a"), &bytes) {
                        prop_assert!(triangles.iter().flatten().all(|&v| (v as usize) < vertices.len()));
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod obj_tests {
    use super::*;

    fn read(text: &str) -> Result<Triangles, String> {
        parse_obj(Path::new("a.obj"), text.as_bytes()).map_err(|e| e.to_string())
    }

    #[test]
    fn reads_vertices_and_faces_in_double_precision() {
        let text = "# desk\r\nmtllib desk.mtl\no top\nv 0 0 0.1\nv 1 0 .1 1.0\nv 1 1 1e-1 0.5 0.5 0.5\nvt 0 0\n\
                    vn 0 0 1\nf 1/1/1 2//1 3/1 4 # forward\nv 0 1 0.1\nusemtl oak\ns off\nf -4 -3 -1\n";
        let (vertices, triangles) = read(text).unwrap();
        assert_eq!(vertices, [[0.0, 0.0, 0.1], [1.0, 0.0, 0.1], [1.0, 1.0, 0.1], [0.0, 1.0, 0.1]]);
        assert_eq!(triangles, [[0, 1, 2], [0, 2, 3], [0, 1, 3]]);
    }

    #[test]
    fn continued_lines_keep_line_numbers() {
        let text = "v 0 0 0 # C:\\a\\\r\nv 1 \\\r\n0 0\n\nv 0 1 0\nf 1 2 \\\n\\\n3\n";
        assert_eq!(read(text).unwrap().1, [[0, 1, 2]]);
        assert_eq!(
            read(&format!("{text}f 1 2 x\n")).unwrap_err().split(';').next().unwrap(),
            "a.obj:9:7: `x` is not a vertex index (1 and up, or -1 and down from the end)"
        );
        assert_eq!(read(&text.replace(['\n', '\r'], "\r")).unwrap().1, [[0, 1, 2]], "CR ends a line");
        assert!(read("v 0 0 0\nf 1 1 1\\").unwrap().1.is_empty());
    }

    #[test]
    fn reports_position_of_invalid_input() {
        let v = "v 0 0 0\nv 1 0 0\nv 0 1 0\n";
        let index = "is not a vertex index (1 and up, or -1 and down from the end); correct the index";
        let range =
            |index: &str| format!("a.obj:4:1: a face names vertex {index}, counted from 0, of 3; correct the index");
        let cases = [
            (format!("{v}f 1 2 0\n"), format!("a.obj:4:7: `0` {index}")),
            (format!("{v}f 1 2 x/1\n"), format!("a.obj:4:7: `x/1` {index}")),
            (format!("{v}f 1 2 /1\n"), format!("a.obj:4:7: `/1` {index}")),
            (format!("{v}f 1 2 3/a\n"), format!("a.obj:4:7: `3/a` {index}")),
            (format!("{v}f 1 2 3/1/1/1\n"), format!("a.obj:4:7: `3/1/1/1` {index}")),
            (format!("{v}f 1 2 4\n"), range("3")),
            (format!("{v}f 1 2 -4\n"), range("-1")),
            (format!("{v}f 1 2 {}\n", i64::MIN), range(&(i64::MIN + 3).to_string())),
            (format!("{v}f 1 2\n"), "a.obj:4:1: a face has 2 corners; give at least three, or remove it".into()),
            (format!("{v}v 1 nan 0\n"), format!("a.obj:4:5: `nan` is not finite; {VERTEX_ADVICE}")),
            (format!("{v}v 1 o 0\n"), format!("a.obj:4:5: `o` is not a number; {VERTEX_ADVICE}")),
            (
                format!("{v}v 1 0\n"),
                format!("a.obj:4:6: the row ends after 3 of the 4 columns that `z` needs; {VERTEX_ADVICE}"),
            ),
            (
                "<html>\n".into(),
                "a.obj:1:1: `<html>` is not a vertex or face statement; export triangles from the modelling program"
                    .into(),
            ),
        ];
        for (text, message) in cases {
            assert_eq!(read(&text).unwrap_err(), message);
        }
    }
}

#[cfg(test)]
mod point_tests {
    use super::*;

    fn read(name: &str, bytes: &[u8]) -> Result<Vec<[f64; 3]>, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        read_points(&path).map_err(|e| e.to_string().replace(&folder.path().display().to_string(), "DIR"))
    }

    #[test]
    fn xyz_and_csv_give_equal_points() {
        let points = vec![[1.0, -2.0, 0.5], [0.0, 1e-3, 3.0]];
        assert_eq!(read("a.xyz", b"# room\n1 -2 0.5 255 0 0\n\n0\t1e-3 3\n").unwrap(), points);
        assert_eq!(read("a.csv", b"1,-2,0.5\r\n0,1e-3,3,extra\r\n").unwrap(), points);
        assert_eq!(read("a.csv", b"//X,Y,Z,R\n1,-2,0.5,9\n0,1e-3,3,255.0\n").unwrap(), points);
        assert_eq!(read("a.csv", b"x [m],Y (m),z [metres]\r1,-2,0.5\r0,1e-3,3\r").unwrap(), points);
        assert_eq!(read("a.txt", b"//X Y Z\n2\n1 -2 0.5\n0 1e-3 3\n").unwrap(), points);
        assert_eq!(read("a.CSV", b"\"z\",name,X,y\n0.5,\"a,b\",1,-2\n3,c,0,1e-3\n").unwrap(), points);
    }

    #[test]
    fn reports_position_of_invalid_text() {
        let advice = POINT_ADVICE;
        let cases: [(&str, &[u8], String); 13] = [
            (
                "a.csv",
                b"x [mm],y [mm],z [mm]\n1,2,3\n",
                "DIR/a.csv:1:1: `x [mm]` is not in metres; convert the column, and name it `x`".into(),
            ),
            ("a.txt", b"3\n1 2 3\n", "DIR/a.txt:1:1: announces 3 points, but 1 follow; copy the file again".into()),
            ("a.csv", b"x,y,z,X\n1,2,3,4\n", "DIR/a.csv:1:7: a second column `x`; name each of x, y and z once".into()),
            (
                "a.csv",
                b"x,y,z\n1,2,3,,\n1,5,2,3\n",
                "DIR/a.csv:3:7: the row has 4 fields, its header 3; write decimals with a point, and one value per column".into(),
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
            ("a.xyz", b"", "DIR/a.xyz: is empty; check the path of the point cloud".into()),
            ("a.las", b"", "DIR/a.las: unsupported point cloud format; use .ply, .xyz or .csv".into()),
        ];
        for (name, bytes, message) in cases {
            assert_eq!(read(name, bytes).unwrap_err(), message);
        }
        let missing = read_points(Path::new("no/such.ply")).unwrap_err();
        assert_eq!(missing.to_string(), "cannot read no/such.ply: no such file; check the path of the point cloud");
    }
}
