//! STL: triangles one by one, as text or as binary. The normals in the file are left out: the order of the corners says
//! the same.

use crate::polygons::Triangles;
use crate::text::{Field, VERTEX_ADVICE, coordinate, fault_of, lines, split_blanks};
use pwrfgs_core::{Error, Result, words::quoted};
use std::{iter::Peekable, path::Path};

/// Bytes before the first triangle of a binary file: 80 that mean nothing, then the count.
const HEADER: usize = 84;
/// Bytes of a triangle: normal, three vertices, two bytes that mean nothing.
const TRIANGLE: usize = 50;
const ANEW: &str = "the file is cut short: export it anew";

/// Binary is what has the length that its count says: the header of some binary files begins with `solid` like text.
pub(super) fn parse(path: &Path, bytes: &[u8]) -> Result<Triangles> {
    let count = bytes.get(HEADER - 4..HEADER).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]) as usize);
    let length = count.and_then(|count| count.checked_mul(TRIANGLE)?.checked_add(HEADER));
    let corners = if length == Some(bytes.len()) {
        parse_binary(path, bytes)?
    } else if bytes.trim_ascii_start().get(..5).is_some_and(|word| word.eq_ignore_ascii_case(b"solid")) {
        parse_ascii(path, &String::from_utf8_lossy(bytes))?
    } else {
        let what = match (count, length) {
            (Some(count), Some(length)) => format!("{count} triangles need {length} bytes, but it has {}", bytes.len()),
            _ => format!("has {} bytes, fewer than the header of a binary STL file", bytes.len()),
        };
        return Err(Error::input(path, format!("{what}; the file is no STL, or cut short: export it anew")));
    };
    let triangles = (0..corners.len() as u32 / 3).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
    Ok((corners, triangles))
}

fn parse_binary(path: &Path, bytes: &[u8]) -> Result<Vec<[f64; 3]>> {
    let mut corners = Vec::with_capacity((bytes.len() - HEADER) / TRIANGLE * 3);
    for (triangle, raw) in bytes[HEADER..].chunks_exact(TRIANGLE).enumerate() {
        for corner in raw[12..48].chunks_exact(12) {
            let value = |k: usize| f32::from_le_bytes([corner[k], corner[k + 1], corner[k + 2], corner[k + 3]]);
            let vertex = [value(0), value(4), value(8)];
            let vertex = vertex.map(f64::from);
            if let Some(fault) = fault_of(vertex) {
                let what = format!("a vertex of triangle {} is {fault}; {VERTEX_ADVICE}", triangle + 1);
                return Err(Error::input(path, what));
            }
            corners.push(vertex);
        }
    }
    Ok(corners)
}

fn parse_ascii(path: &Path, text: &str) -> Result<Vec<[f64; 3]>> {
    let words = lines(text).flat_map(|(line, row)| {
        let mut fields = split_blanks(row);
        let is_title = fields.first().is_some_and(|f| is(*f, "solid") || is(*f, "endsolid"));
        fields.truncate(if is_title { 1 } else { fields.len() });
        fields.into_iter().map(move |field| (line, field))
    });
    let mut words = Words { path, words: words.peekable() };
    let mut corners = Vec::new();
    while words.words.peek().is_some() {
        words.the("solid")?;
        while words.is_facet()? {
            words.the("normal")?;
            (0..3).try_for_each(|_| words.next("a number").map(|_| ()))?;
            words.the("outer")?;
            words.the("loop")?;
            for _ in 0..3 {
                words.the("vertex")?;
                corners.push([words.number()?, words.number()?, words.number()?]);
            }
            words.the("endloop")?;
            words.the("endfacet")?;
        }
    }
    Ok(corners)
}

fn is(field: Field<'_>, word: &str) -> bool {
    field.text.eq_ignore_ascii_case(word)
}

/// The words of an ascii file that have not been read, with their lines.
struct Words<'a, I: Iterator<Item = (usize, Field<'a>)>> {
    path: &'a Path,
    words: Peekable<I>,
}

impl<'a, I: Iterator<Item = (usize, Field<'a>)>> Words<'a, I> {
    fn next(&mut self, expected: &str) -> Result<(usize, Field<'a>)> {
        self.words.next().ok_or_else(|| Error::input(self.path, format!("ends where {expected} should be; {ANEW}")))
    }

    fn the(&mut self, word: &str) -> Result<()> {
        let (line, field) = self.next(&format!("`{word}`"))?;
        if is(field, word) { Ok(()) } else { Err(self.unexpected(line, field, word)) }
    }

    /// `facet` against `endsolid`.
    fn is_facet(&mut self) -> Result<bool> {
        let (line, field) = self.next("`facet` or `endsolid`")?;
        if is(field, "facet") || is(field, "endsolid") {
            Ok(is(field, "facet"))
        } else {
            Err(self.unexpected(line, field, "facet"))
        }
    }

    fn number(&mut self) -> Result<f64> {
        let (line, field) = self.next("a number")?;
        coordinate(self.path, line, field, VERTEX_ADVICE)
    }

    fn unexpected(&self, line: usize, field: Field<'_>, word: &str) -> Error {
        let what = format!("{} stands where `{word}` should; export the file anew", quoted(field.text));
        Error::at(self.path, line, field.column, what)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ASCII: &str = "solid a desk\n facet normal 0 nan 1\n  outer loop\n   vertex 0 0 0\n   vertex 1 0 0\n   \
        vertex 0 0.1 0\n  endloop\n endfacet\nendsolid a desk\nSOLID\nFACET NORMAL 0 0 1 OUTER LOOP\n\
        VERTEX 0 0 1 VERTEX 1 0 1 VERTEX 0 1 1\nENDLOOP ENDFACET\nENDSOLID\n";

    fn read(bytes: &[u8]) -> Result<Triangles, String> {
        parse(Path::new("a.stl"), bytes).map_err(|e| e.to_string())
    }

    fn binary(title: &str, corners: &[[f32; 3]]) -> Vec<u8> {
        let mut out = title.as_bytes().to_vec();
        out.resize(80, b' ');
        out.extend((corners.len() as u32 / 3).to_le_bytes());
        for triangle in corners.chunks(3) {
            out.extend([0; 12]);
            triangle.iter().flatten().for_each(|v| out.extend(v.to_le_bytes()));
            out.extend([0; 2]);
        }
        out
    }

    #[test]
    fn ascii_is_read_in_double_precision_over_several_solids() {
        let (vertices, triangles) = read(ASCII.as_bytes()).unwrap();
        assert_eq!(vertices[..3], [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 0.1, 0.0]]);
        assert_eq!(vertices[3..], [[0.0, 0.0, 1.0], [1.0, 0.0, 1.0], [0.0, 1.0, 1.0]]);
        assert_eq!(triangles, [[0, 1, 2], [3, 4, 5]]);
        assert_eq!(read(b"solid\nendsolid").unwrap(), Triangles::default());
    }

    #[test]
    fn binary_is_read_even_if_its_header_says_solid() {
        let corners = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.5, 0.0]];
        for title in ["", "solid made by a program"] {
            let (vertices, triangles) = read(&binary(title, &corners)).unwrap();
            assert_eq!(vertices, corners.map(|c| c.map(f64::from)));
            assert_eq!(triangles, [[0, 1, 2]]);
        }
        assert_eq!(read(&binary("", &[])).unwrap(), Triangles::default());
    }

    #[test]
    fn every_truncation_is_an_error() {
        let two = binary("", &[[1.0; 3]; 6]);
        for length in 0..two.len() {
            assert!(read(&two[..length]).is_err(), "{length} of {} bytes", two.len());
        }
        let last_word = ASCII.len() - 1;
        // A file may end between its solids.
        let between = ASCII.find("SOLID").unwrap();
        for length in (0..last_word).filter(|l| !(between - "d a desk\n".len()..=between).contains(l)) {
            assert!(read(&ASCII.as_bytes()[..length]).is_err(), "{length} of {} bytes", ASCII.len());
        }
    }

    #[test]
    fn mistakes_are_told_with_their_place() {
        let cases = [
            (ASCII.replace("0 0.1 0", "0 inf 0"), format!("a.stl:6:13: `inf` is not finite; {VERTEX_ADVICE}")),
            (ASCII.replace("0 0.1 0", "0 0.1"), format!("a.stl:7:3: `endloop` is not a number; {VERTEX_ADVICE}")),
            (
                ASCII.replace("  endloop\n", ""),
                "a.stl:7:2: `endfacet` stands where `endloop` should; export the file anew".into(),
            ),
            (
                ASCII.replace("SOLID\nFACET", "FACET"),
                "a.stl:10:1: `FACET` stands where `solid` should; export the file anew".into(),
            ),
            (
                "solid\nfacet normal 0 0 1\n".into(),
                "a.stl: ends where `outer` should be; the file is cut short: export it anew".into(),
            ),
            (
                "not a mesh".into(),
                "a.stl: has 10 bytes, fewer than the header of a binary STL file; the file is no STL, or cut short: export it anew".into(),
            ),
        ];
        for (text, message) in cases {
            assert_eq!(read(text.as_bytes()).unwrap_err(), message);
        }
        let cut = &binary("", &[[1.0; 3]; 6])[..134];
        assert_eq!(
            read(cut).unwrap_err(),
            "a.stl: 2 triangles need 184 bytes, but it has 134; the file is no STL, or cut short: export it anew"
        );
        let infinite = binary("", &[[0.0; 3], [0.0; 3], [0.0, f32::INFINITY, 0.0]]);
        assert_eq!(
            read(&infinite).unwrap_err(),
            format!("a.stl: a vertex of triangle 1 is not finite; {VERTEX_ADVICE}")
        );
    }
}
