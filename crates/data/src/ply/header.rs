//! The header of a PLY file: encoding, elements and their properties.

use crate::text::{TextField, split_blanks};
use pwrfgs_core::{Error, Result, messages::quoted};
use std::path::Path;

/// Largest number of lines of a header: each name is compared with all others.
const MOST_LINES: usize = 10_000;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum PlyEncoding {
    Ascii,
    Little,
    Big,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

#[derive(Clone, Copy, Debug)]
pub(super) enum PropertyKind {
    Scalar(Scalar),
    List { length: Scalar, item: Scalar },
}

#[derive(Debug)]
pub(super) struct Property {
    pub(super) name: String,
    pub(super) kind: PropertyKind,
}

#[derive(Debug)]
pub(super) struct PlyElement {
    pub(super) name: String,
    pub(super) count: usize,
    pub(super) properties: Vec<Property>,
    line: usize,
}

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
    fn named(name: &str) -> Option<Self> {
        Some(match name {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return None,
        })
    }

    pub(super) fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    /// Expected format of a number in an ascii file, if the text does not match it.
    pub(super) fn misfit(self, text: &str) -> Option<&'static str> {
        let whole = |low: i64, high: i64| text.parse().is_ok_and(|v: i64| (low..=high).contains(&v));
        let (fits, what) = match self {
            Self::I8 => (whole(-0x80, 0x7f), "a char, a whole number from -128 to 127"),
            Self::U8 => (whole(0, 0xff), "a uchar, a whole number from 0 to 255"),
            Self::I16 => (whole(-0x8000, 0x7fff), "a short, a whole number from -32768 to 32767"),
            Self::U16 => (whole(0, 0xffff), "a ushort, a whole number from 0 to 65535"),
            Self::I32 => (whole(i64::from(i32::MIN), i64::from(i32::MAX)), "an int, a whole number of 32 bits"),
            Self::U32 => (whole(0, i64::from(u32::MAX)), "a uint, a whole number of 32 bits"),
            Self::F32 | Self::F64 => (text.parse::<f64>().is_ok(), "a number"),
        };
        (!fits).then_some(what)
    }

    /// Value of the number in `raw`, which is [`Self::size`] bytes long.
    pub(super) fn value(self, raw: &[u8], is_big: bool) -> f64 {
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
            Self::F32 => f64::from(f32::from_le_bytes([a, b, c, d])),
            Self::F64 => f64::from_le_bytes(bytes),
        }
    }
}

impl PlyHeader {
    /// Reads up to and including `end_header`.
    pub(super) fn parse(path: &Path, bytes: &[u8]) -> Result<Self> {
        let (mut encoding, mut elements) = (None, Vec::new());
        let (mut start, mut line) = (0, 0);
        loop {
            let Some(length) = bytes[start..].iter().position(|&b| b == b'\n') else {
                let what = if bytes.starts_with(b"ply") { UNENDED } else { NOT_PLY };
                return Err(Error::input(path, what));
            };
            let text = String::from_utf8_lossy(&bytes[start..start + length]);
            start += length + 1;
            line += 1;
            if line > MOST_LINES {
                return Err(Error::at(
                    path,
                    line,
                    1,
                    format!("the header has more than {MOST_LINES} lines; shorten it"),
                ));
            }
            let fields = split_blanks(&text);
            let words: Vec<&str> = fields.iter().map(|f| f.text).collect();
            let fault = |field: usize, what: &str| fault(path, line, fields[field], what);
            match (line, words.as_slice()) {
                (1, ["ply"]) | (2.., [] | ["comment" | "obj_info", ..]) => {}
                (1, _) => return Err(Error::at(path, 1, 1, NOT_PLY)),
                (_, ["format", ..]) if encoding.is_some() => {
                    return Err(fault(0, "is repeated; keep one"));
                }
                (_, ["format", name, ..]) => {
                    encoding = Some(PlyEncoding::named(name).ok_or_else(|| fault(1, FORMATS))?);
                }
                (_, ["element", name, count]) => {
                    let count = count.parse().ok().ok_or_else(|| fault(2, "is not a count; write a whole number"))?;
                    if elements.iter().any(|e: &PlyElement| e.name == *name) {
                        return Err(fault(1, "is a repeated element; give each element a unique name"));
                    }
                    elements.push(PlyElement { name: (*name).to_owned(), count, properties: Vec::new(), line });
                }
                (_, ["property", ..]) => {
                    let element: &mut PlyElement = elements.last_mut().ok_or_else(|| fault(0, UNOWNED))?;
                    let property = property(path, line, &fields)?;
                    if element.properties.iter().any(|p| p.name == property.name) {
                        let twice = "is a repeated property; give each property a unique name";
                        return Err(fault(fields.len() - 1, twice));
                    }
                    element.properties.push(property);
                }
                (_, ["end_header"]) => break,
                _ => return Err(fault(0, "is not understood in a PLY header; remove or correct the line")),
            }
        }
        let encoding = encoding.ok_or_else(|| Error::input(path, UNFORMATTED))?;
        let (vertex, xyz) = vertex(path, &elements)?;
        Ok(Self { encoding, elements, vertex, xyz, bytes: start, lines: line })
    }

    /// Index of the element `face`, and of its corner list.
    pub(super) fn corners(&self, path: &Path) -> Result<(usize, usize)> {
        let Some(face) = self.elements.iter().position(|e| e.name == "face") else {
            return Err(Error::input(path, "has no element `face`; export a mesh, not a point cloud"));
        };
        let is_it = |p: &Property| {
            ["vertex_indices", "vertex_index"].contains(&p.name.as_str()) && matches!(p.kind, PropertyKind::List { .. })
        };
        let list = self.elements[face].properties.iter().position(is_it).ok_or_else(|| {
            let what = "element `face` has no list `vertex_indices`; export faces by their vertices";
            Error::at(path, self.elements[face].line, 1, what)
        })?;
        Ok((face, list))
    }
}

const UNENDED: &str = "the header has no end_header; copy the file again";
const UNOWNED: &str = "precedes any element; write an `element` line first";
const UNFORMATTED: &str = "has no `format` line; write `format ascii 1.0` or a binary one";
const NOT_PLY: &str = "is not a PLY file, which begins with the line `ply`; check the file or its extension";
const FORMATS: &str = "is not a format; use ascii, binary_little_endian or binary_big_endian";
const TYPES: &str = "is not a type; use char, uchar, short, ushort, int, uint, float or double";

impl PlyEncoding {
    fn named(name: &str) -> Option<Self> {
        match name {
            "ascii" => Some(Self::Ascii),
            "binary_little_endian" => Some(Self::Little),
            "binary_big_endian" => Some(Self::Big),
            _ => None,
        }
    }
}

/// Error at one word of the header.
fn fault(path: &Path, line: usize, field: TextField<'_>, what: &str) -> Error {
    Error::at(path, line, field.column, format!("{} {what}", quoted(field.text)))
}

/// Parses `property TYPE NAME` or `property list TYPE TYPE NAME`.
fn property(path: &Path, line: usize, fields: &[TextField<'_>]) -> Result<Property> {
    let scalar = |i: usize| Scalar::named(fields[i].text).ok_or_else(|| fault(path, line, fields[i], TYPES));
    let (kind, name) = match fields.len() {
        3 => (PropertyKind::Scalar(scalar(1)?), fields[2]),
        5 if fields[1].text == "list" => (PropertyKind::List { length: scalar(2)?, item: scalar(3)? }, fields[4]),
        _ => return Err(fault(path, line, fields[0], "needs a type and a name; write `property float x`")),
    };
    Ok(Property { name: name.text.to_owned(), kind })
}

/// Index of the element `vertex`, and of its x, y and z.
fn vertex(path: &Path, elements: &[PlyElement]) -> Result<(usize, [usize; 3])> {
    let Some(vertex) = elements.iter().position(|e| e.name == "vertex") else {
        return Err(Error::input(path, "has no element `vertex`; export the cloud with its points"));
    };
    let mut xyz = [0; 3];
    for (place, name) in xyz.iter_mut().zip(["x", "y", "z"]) {
        let is_it = |p: &Property| p.name == name && matches!(p.kind, PropertyKind::Scalar(_));
        *place = elements[vertex].properties.iter().position(is_it).ok_or_else(|| {
            let what = format!("element `vertex` has no property `{name}`; export x, y and z as float or double");
            Error::at(path, elements[vertex].line, 1, what)
        })?;
    }
    Ok((vertex, xyz))
}
