//! Wavefront OBJ: the vertices and faces.

use crate::polygons::{Polygons, Triangles};
use crate::text::{Field, VERTEX_ADVICE, XyzColumns, lines, split_blanks};
use pwrfgs_core::{Error, Result, words::quoted};
use std::path::Path;

/// Statements that say nothing about the surface.
const LEFT_OUT: &str =
    "vn vt vp o g s mg l p usemtl mtllib usemap maplib bevel c_interp d_interp lod shadow_obj trace_obj";

pub(super) fn parse(path: &Path, bytes: &[u8]) -> Result<Triangles> {
    let text = String::from_utf8_lossy(bytes);
    let rows = || lines(&text).map(|(line, row)| (line, split_blanks(row.split('#').next().unwrap_or(row))));
    // A face may name a vertex that comes after it.
    let count = rows().filter(|(_, fields)| fields.first().is_some_and(|f| f.text == "v")).count();
    let (mut vertices, mut polygons) = (Vec::with_capacity(count), Polygons::default());
    for (line, fields) in rows() {
        let Some(keyword) = fields.first() else { continue };
        match keyword.text {
            "v" => vertices.push(XyzColumns([1, 2, 3]).read(path, line, &fields, VERTEX_ADVICE)?),
            "f" => {
                let corner = |field: &Field<'_>| corner(path, line, *field, vertices.len());
                let corners = fields[1..].iter().map(corner).collect::<Result<Vec<i64>>>()?;
                polygons.push(&corners, count).map_err(|what| Error::at(path, line, keyword.column, what))?;
            }
            word if LEFT_OUT.split(' ').any(|left_out| left_out == word) => {}
            word => {
                let what = "is no statement for vertices and faces; export triangles from the modelling program";
                return Err(Error::at(path, line, keyword.column, format!("{} {what}", quoted(word))));
            }
        }
    }
    polygons.triangulate(path, vertices)
}

/// The vertex of a corner such as `3`, `-1`, `3/1` or `3//2`, counted from 0. A negative one counts back from the last
/// vertex so far.
fn corner(path: &Path, line: usize, field: Field<'_>, so_far: usize) -> Result<i64> {
    let mut parts = field.text.split('/');
    let index = parts.next().and_then(|text| text.parse::<i64>().ok()).filter(|&index| index != 0);
    // Texture and normal, each of which may be left out, and nothing more.
    let is_whole = parts.clone().count() <= 2 && parts.all(|part| part.is_empty() || part.parse::<i64>().is_ok());
    let index = index.filter(|_| is_whole);
    let index = index.ok_or_else(|| {
        let what = "is no vertex, which are counted from 1 or, backwards, from -1; correct the index";
        Error::at(path, line, field.column, format!("{} {what}", quoted(field.text)))
    })?;
    Ok(if index > 0 { index - 1 } else { index.saturating_add_unsigned(so_far as u64) })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Triangles, String> {
        parse(Path::new("a.obj"), text.as_bytes()).map_err(|e| e.to_string())
    }

    #[test]
    fn vertices_and_faces_of_all_forms_are_read_in_double_precision() {
        let text = "# desk\r\nmtllib desk.mtl\no top\nv 0 0 0.1\nv 1 0 .1 1.0\nv 1 1 1e-1 0.5 0.5 0.5\nvt 0 0\n\
                    vn 0 0 1\nf 1/1/1 2//1 3/1 4 # forward\nv 0 1 0.1\nusemtl oak\ns off\nf -4 -3 -1\n";
        let (vertices, triangles) = read(text).unwrap();
        assert_eq!(vertices, [[0.0, 0.0, 0.1], [1.0, 0.0, 0.1], [1.0, 1.0, 0.1], [0.0, 1.0, 0.1]]);
        assert_eq!(triangles, [[0, 1, 2], [0, 2, 3], [0, 1, 3]]);
    }

    #[test]
    fn mistakes_are_told_with_their_place() {
        let v = "v 0 0 0\nv 1 0 0\nv 0 1 0\n";
        let index = "is no vertex, which are counted from 1 or, backwards, from -1; correct the index";
        let range =
            |found: &str| format!("a.obj:4:1: a face names vertex {found}, counted from 0, of 3; correct the index");
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
                "a.obj:1:1: `<html>` is no statement for vertices and faces; export triangles from the modelling program"
                    .into(),
            ),
        ];
        for (text, message) in cases {
            assert_eq!(read(&text).unwrap_err(), message);
        }
    }
}
