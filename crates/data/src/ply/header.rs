//! The header of a PLY file: encoding, elements and their properties.

use crate::polygons::MOST_TRIANGLES;
use crate::text::TextRow;
use pwrfgs_core::{Error, Result, messages::quoted};
use std::path::Path;

/// Element of triangle strips, as the Stanford models have.
pub(super) const STRIPS: &str = "tristrips";
/// Largest number of lines of a header: each name is compared with all others.
const MOST_LINES: usize = 10_000;

/// Encoding of the body.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum PlyEncoding {
    Ascii,
    Little,
    Big,
}

/// Number type of a property.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    I64,
    U64,
    F32,
    F64,
}

/// Content of a property: one number, or a list that begins with its length.
#[derive(Clone, Copy, Debug)]
pub(super) enum PropertyKind {
    Scalar(Scalar),
    List { length: Scalar, item: Scalar },
}

/// Property of the rows of an element.
#[derive(Debug)]
pub(super) struct Property {
    pub(super) name: String,
    pub(super) kind: PropertyKind,
}

/// Table of the body: `count` rows with these properties.
#[derive(Debug)]
pub(super) struct PlyElement {
    pub(super) name: String,
    pub(super) count: usize,
    pub(super) properties: Vec<Property>,
    /// Line of its declaration, counted from 1.
    line: usize,
}

/// Parsed header.
#[derive(Debug)]
pub(super) struct PlyHeader {
    pub(super) encoding: PlyEncoding,
    pub(super) elements: Vec<PlyElement>,
    /// Index of the element `vertex`, and of its properties x, y and z.
    pub(super) vertex: usize,
    pub(super) xyz: [usize; 3],
    /// Length of the header, in bytes and lines.
    pub(super) bytes: usize,
    pub(super) lines: usize,
}

impl Scalar {
    /// Parses the name of a number type; `None` for other words.
    fn parse(name: &str) -> Option<Self> {
        Some(match name {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "int64" => Self::I64,
            "uint64" => Self::U64,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return None,
        })
    }

    /// Returns the size of a number, bytes.
    pub(super) fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::I64 | Self::U64 | Self::F64 => 8,
        }
    }

    /// Converts the number in `raw`, which is [`Self::size`] bytes long, big or little endian.
    pub(super) fn to_number(self, raw: &[u8], is_big: bool) -> f64 {
        let mut bytes = [0; 8];
        bytes[..raw.len()].copy_from_slice(raw);
        if is_big {
            bytes[..raw.len()].reverse();
        }
        let [a, b, c, d, ..] = bytes;
        match self {
            Self::I8 => f64::from(i8::from_le_bytes([a])),
            Self::U8 => f64::from(a),
            Self::I16 => f64::from(i16::from_le_bytes([a, b])),
            Self::U16 => f64::from(u16::from_le_bytes([a, b])),
            Self::I32 => f64::from(i32::from_le_bytes([a, b, c, d])),
            Self::U32 => f64::from(u32::from_le_bytes([a, b, c, d])),
            Self::I64 => i64::from_le_bytes(bytes) as f64,
            Self::U64 => u64::from_le_bytes(bytes) as f64,
            Self::F32 => f64::from(f32::from_le_bytes([a, b, c, d])),
            Self::F64 => f64::from_le_bytes(bytes),
        }
    }
}

impl PlyHeader {
    /// Parses the header, up to and including `end_header`; its lines end by LF, CR LF, or CR alone. Returns an error for an
    /// invalid or missing line.
    pub(super) fn parse(path: &Path, bytes: &[u8]) -> Result<Self> {
        let is_cr = bytes.starts_with(b"ply\r") && !bytes.starts_with(b"ply\r\n");
        let line_end = if is_cr { b'\r' } else { b'\n' };
        let (mut encoding, mut elements) = (None, Vec::new());
        let (mut start, mut line) = (0, 0);
        loop {
            let Some(length) = bytes[start..].iter().position(|&b| b == line_end) else {
                return Err(Error::input(path, if bytes.starts_with(b"ply") { UNENDED } else { NOT_PLY }));
            };
            let text = String::from_utf8_lossy(&bytes[start..start + length]);
            start += length + 1;
            line += 1;
            let row = TextRow::split_at_blanks(path, (line, &text));
            if line > MOST_LINES {
                return Err(row.fault(1, format!("the header has more than {MOST_LINES} lines; shorten it")));
            }
            let words: Vec<&str> = row.fields.iter().map(|field| field.text).collect();
            match (line, words.as_slice()) {
                (1, ["ply"]) | (2.., [] | ["comment" | "obj_info", ..]) => {}
                (1, _) => return Err(row.fault(1, NOT_PLY)),
                (_, ["format", ..]) if encoding.is_some() => return Err(word_fault(&row, 0, "is repeated; keep one")),
                (_, ["format", name, ..]) => {
                    encoding = Some(PlyEncoding::parse(name).ok_or_else(|| word_fault(&row, 1, FORMATS))?);
                }
                (_, ["end_header"]) => break,
                _ => add_declaration(&mut elements, &row)?,
            }
        }
        let encoding = encoding.ok_or_else(|| Error::input(path, UNFORMATTED))?;
        let (vertex, xyz) = find_vertex(path, &elements)?;
        Ok(Self { encoding, elements, vertex, xyz, bytes: start, lines: line })
    }

    /// Returns the index of the element `face` or `tristrips`, and of its list of corners. Returns an error if one is missing,
    /// or for too many faces.
    pub(super) fn find_corner_list(&self, path: &Path) -> Result<(usize, usize)> {
        let named = |name: &str| self.elements.iter().position(|e| e.name == name);
        let Some(face) = named("face").or_else(|| named(STRIPS)) else {
            return Err(Error::input(path, "has no element `face`; export a mesh, not a point cloud"));
        };
        let count = self.elements[face].count;
        if count > MOST_TRIANGLES {
            let problem = format!("the mesh has {count} faces, more than {MOST_TRIANGLES}; simplify it");
            return Err(Error::at(path, self.elements[face].line, 1, problem));
        }
        let is_corner_list = |p: &Property| {
            ["vertex_indices", "vertex_index"].contains(&p.name.as_str()) && matches!(p.kind, PropertyKind::List { .. })
        };
        let list = self.elements[face].properties.iter().position(is_corner_list).ok_or_else(|| {
            let problem = "element `face` has no list `vertex_indices`; export faces by their vertices";
            Error::at(path, self.elements[face].line, 1, problem)
        })?;
        Ok((face, list))
    }
}

const UNENDED: &str = "the header has no end_header; copy the file again";
const UNOWNED: &str = "precedes any element; write an `element` line first";
const UNFORMATTED: &str = "has no `format` line; write `format ascii 1.0` or a binary one";
const NOT_PLY: &str = "is not a PLY file, which begins with the line `ply`; check the file or its extension";
const FORMATS: &str = "is not a format; use ascii, binary_little_endian or binary_big_endian";
const TYPES: &str = "is not a type; use char, uchar, short, ushort, int, uint, int64, uint64, float or double";

impl PlyEncoding {
    /// Parses the name of an encoding; `None` for other words.
    fn parse(name: &str) -> Option<Self> {
        match name {
            "ascii" => Some(Self::Ascii),
            "binary_little_endian" => Some(Self::Little),
            "binary_big_endian" => Some(Self::Big),
            _ => None,
        }
    }
}

/// Returns the error `problem` at a word of a header line.
fn word_fault(row: &TextRow<'_>, word: usize, problem: &str) -> Error {
    row.fault(row.fields[word].column, format!("{} {problem}", quoted(row.fields[word].text)))
}

/// Parses the line of an element, or of a property of the last element, and adds it to `elements`. Returns an error for
/// another line, or a repeated name.
fn add_declaration(elements: &mut Vec<PlyElement>, row: &TextRow<'_>) -> Result<()> {
    let words: Vec<&str> = row.fields.iter().map(|field| field.text).collect();
    let fault = |word: usize, problem: &str| word_fault(row, word, problem);
    match words.as_slice() {
        ["element", name, count] => {
            let count = count.parse().ok().ok_or_else(|| fault(2, "is not a count; write a whole number"))?;
            if elements.iter().any(|element| element.name == *name) {
                return Err(fault(1, "is a repeated element; give each element a unique name"));
            }
            let name = (*name).to_owned();
            elements.push(PlyElement { name, count, properties: Vec::new(), line: row.line });
        }
        ["property", ..] => {
            let element = elements.last_mut().ok_or_else(|| fault(0, UNOWNED))?;
            let property = parse_property(row)?;
            if element.properties.iter().any(|p| p.name == property.name) {
                return Err(fault(words.len() - 1, "is a repeated property; give each property a unique name"));
            }
            element.properties.push(property);
        }
        _ => return Err(fault(0, "is not understood in a PLY header; remove or correct the line")),
    }
    Ok(())
}

/// Parses a line `property TYPE NAME` or `property list TYPE TYPE NAME`. Returns an error for another line or type.
fn parse_property(row: &TextRow<'_>) -> Result<Property> {
    let fields = &row.fields;
    let scalar = |word: usize| Scalar::parse(fields[word].text).ok_or_else(|| word_fault(row, word, TYPES));
    let (kind, name) = match fields.len() {
        3 => (PropertyKind::Scalar(scalar(1)?), fields[2]),
        5 if fields[1].text == "list" => (PropertyKind::List { length: scalar(2)?, item: scalar(3)? }, fields[4]),
        _ => return Err(word_fault(row, 0, "needs a type and a name; write `property float x`")),
    };
    Ok(Property { name: name.text.to_owned(), kind })
}

/// Returns the index of the element `vertex`, and of its properties x, y and z. Returns an error if one is missing.
fn find_vertex(path: &Path, elements: &[PlyElement]) -> Result<(usize, [usize; 3])> {
    let Some(vertex) = elements.iter().position(|e| e.name == "vertex") else {
        return Err(Error::input(path, "has no element `vertex`; export the cloud with its points"));
    };
    let mut xyz = [0; 3];
    for (index, name) in xyz.iter_mut().zip(["x", "y", "z"]) {
        let is_coordinate = |p: &Property| p.name == name && matches!(p.kind, PropertyKind::Scalar(_));
        *index = elements[vertex].properties.iter().position(is_coordinate).ok_or_else(|| {
            let problem = format!("element `vertex` has no property `{name}`; export x, y and z as float or double");
            Error::at(path, elements[vertex].line, 1, problem)
        })?;
    }
    Ok((vertex, xyz))
}
