//! PLY: a header, then elements as text or binary of either byte order. Only `x`, `y`, `z` of `vertex` and the corners
//! of `face` are kept; all elements are parsed, so that truncated files are detected.
//!
//! The parser is our own: `ply-rs-bw` rejects blank lines and numbers such as `.5` and `nan` as syntax errors, and its
//! messages have several lines.

mod header;
#[cfg(test)]
mod tests;

use crate::polygons::{Polygons, Triangles};
use crate::text::{POINT_ADVICE, TextField, XyzColumns, fault_of, lines, number, split_blanks};
use header::{PlyElement, PlyEncoding, PlyHeader, PropertyKind, Scalar};
use pwrfgs_core::{Error, Result, messages::quoted};
use std::path::Path;

const ANEW: &str = "the file is cut short: copy it again";
const INDEX_ADVICE: &str = "correct the index of the vertex";

/// Reads the positions of all vertices.
pub(crate) fn parse(path: &Path, bytes: &[u8]) -> Result<Vec<[f64; 3]>> {
    let header = PlyHeader::parse(path, bytes)?;
    Ok(Contents::parse(path, &header, &bytes[header.bytes..], None)?.vertices)
}

/// Reads the surface: vertices, and faces split into triangles.
pub(crate) fn parse_mesh(path: &Path, bytes: &[u8]) -> Result<Triangles> {
    let header = PlyHeader::parse(path, bytes)?;
    let corners = header.corners(path)?;
    let contents = Contents::parse(path, &header, &bytes[header.bytes..], Some(corners))?;
    contents.polygons.triangulate(path, contents.vertices)
}

/// Parsed vertices and faces.
#[derive(Default)]
struct Contents {
    vertices: Vec<[f64; 3]>,
    polygons: Polygons,
}

impl Contents {
    /// Parses the body; `corners`: indices of the face element and of its corner property.
    fn parse(path: &Path, header: &PlyHeader, body: &[u8], corners: Option<(usize, usize)>) -> Result<Self> {
        match header.encoding {
            PlyEncoding::Ascii => Self::parse_ascii(path, header, body, corners),
            PlyEncoding::Little | PlyEncoding::Big => Self::parse_binary(path, header, body, corners),
        }
    }

    fn parse_ascii(path: &Path, header: &PlyHeader, body: &[u8], corners: Option<(usize, usize)>) -> Result<Self> {
        let text = String::from_utf8_lossy(body);
        let mut rows = lines(&text).map(|(line, row)| (line + header.lines, row));
        let mut contents = Self::default();
        for (e, element) in header.elements.iter().enumerate().filter(|(_, element)| !element.properties.is_empty()) {
            for i in 0..element.count {
                let Some((line, row)) = rows.next() else {
                    return Err(Error::input(path, ends(element, i)));
                };
                let fields = split_blanks(row);
                let starts = field_of_each_property(path, line, &fields, element)?;
                if e == header.vertex {
                    let columns = XyzColumns(header.xyz.map(|property| starts[property]));
                    contents.vertices.push(columns.read(path, line, &fields, POINT_ADVICE)?);
                }
                if let Some((_, property)) = corners.filter(|(face, _)| e == *face) {
                    let length = fields[starts[property]].text.parse().unwrap_or(0);
                    let listed = fields[starts[property] + 1..].iter().take(length);
                    let row = listed.map(|field| index(path, line, *field)).collect::<Result<Vec<i64>>>()?;
                    let fault = |what| Error::at(path, line, 1, what);
                    contents.polygons.push(&row, header.elements[header.vertex].count).map_err(fault)?;
                }
            }
        }
        match rows.next() {
            Some((line, _)) => Err(Error::at(path, line, 1, "a row more than the header counts; correct its counts")),
            None => Ok(contents),
        }
    }

    fn parse_binary(path: &Path, header: &PlyHeader, body: &[u8], corners: Option<(usize, usize)>) -> Result<Self> {
        let mut body = BinaryBody { rest: body, is_big: header.encoding == PlyEncoding::Big };
        let mut contents = Self::default();
        let mut row = Vec::new();
        for (e, element) in header.elements.iter().enumerate().filter(|(_, element)| !element.properties.is_empty()) {
            for i in 0..element.count {
                let mut point = [0.0; 3];
                let ended = || Error::input(path, ends(element, i));
                for (p, property) in element.properties.iter().enumerate() {
                    match property.kind {
                        PropertyKind::Scalar(scalar) => {
                            let value = body.value(scalar).ok_or_else(ended)?;
                            if let Some(k) = header.xyz.iter().position(|&xyz| e == header.vertex && xyz == p) {
                                point[k] = value;
                            }
                        }
                        PropertyKind::List { length, item } => {
                            let raw = body.list(length, item).ok_or_else(ended)?;
                            if corners == Some((e, p)) {
                                let value = |raw| whole(item.value(raw, body.is_big)).unwrap_or(-1); // out of range
                                row.clear();
                                row.extend(raw.chunks_exact(item.size()).map(value));
                                let fault = |what| Error::input(path, format!("row {} of `face`: {what}", i + 1));
                                contents.polygons.push(&row, header.elements[header.vertex].count).map_err(fault)?;
                            }
                        }
                    }
                }
                if e == header.vertex {
                    if let Some(fault) = fault_of(point) {
                        let what = format!("vertex {} of {} is {fault}; {POINT_ADVICE}", i + 1, element.count);
                        return Err(Error::input(path, what));
                    }
                    contents.vertices.push(point);
                }
            }
        }
        match body.rest.len() {
            0 => Ok(contents),
            more => Err(Error::input(path, format!("{more} bytes follow the last row; correct the header's counts"))),
        }
    }
}

/// Index of the first field of each property in a row: a list has a length field followed by that many fields.
fn field_of_each_property(
    path: &Path,
    line: usize,
    fields: &[TextField<'_>],
    element: &PlyElement,
) -> Result<Vec<usize>> {
    let mut starts = Vec::with_capacity(element.properties.len());
    let mut next = 0;
    for property in &element.properties {
        starts.push(next);
        let fits = |field: &TextField<'_>, scalar: Scalar| match scalar.misfit(field.text) {
            Some(what) => {
                let what = format!("{} is not {what}, as property `{}` is", quoted(field.text), property.name);
                Err(Error::at(path, line, field.column, what + "; correct the row or the header"))
            }
            None => Ok(()),
        };
        let taken = match (property.kind, fields.get(next)) {
            (PropertyKind::List { length: kind, item }, Some(field)) => {
                let length: Option<usize> = field.text.parse().ok();
                let fault = || format!("{} is not the length of a list; correct the row", quoted(field.text));
                let length = length.ok_or_else(|| Error::at(path, line, field.column, fault()))?;
                fits(field, kind)?;
                fields[next + 1..].iter().take(length).try_for_each(|field| fits(field, item))?;
                length.saturating_add(1)
            }
            // The point parser reports this in more detail.
            (PropertyKind::Scalar(Scalar::F32 | Scalar::F64), _)
                if ["x", "y", "z"].contains(&property.name.as_str()) =>
            {
                1
            }
            (PropertyKind::Scalar(scalar), Some(field)) => fits(field, scalar).map(|()| 1)?,
            (_, None) => 1,
        };
        next = next.saturating_add(taken);
    }
    if let Some(field) = fields.get(next) {
        let what = format!("{} is more than the properties of element `{}`", quoted(field.text), element.name);
        return Err(Error::at(path, line, field.column, what + "; correct the row or the header"));
    }
    if next > fields.len() {
        let end = fields.last().map_or(1, |f| f.column + f.text.chars().count());
        let what = format!("the row of element `{}` ends early; give every property of the header", element.name);
        return Err(Error::at(path, line, end, what));
    }
    Ok(starts)
}

/// Parses a whole number in a list of corners.
fn index(path: &Path, line: usize, field: TextField<'_>) -> Result<i64> {
    let value = number(path, line, field, INDEX_ADVICE)?;
    let fault = || Error::at(path, line, field.column, format!("{} is not whole; {INDEX_ADVICE}", quoted(field.text)));
    whole(value).ok_or_else(fault)
}

/// Converts to an integer; indices beyond 2^53 are out of range in any case.
fn whole(value: f64) -> Option<i64> {
    (value.fract() == 0.0).then_some(value as i64)
}

fn ends(element: &PlyElement, done: usize) -> String {
    format!("ends after {done} of {} rows of element `{}`; {ANEW}", element.count, element.name)
}

/// Remaining bytes of a binary body; reads return `None` at its end.
struct BinaryBody<'a> {
    rest: &'a [u8],
    is_big: bool,
}

impl<'a> BinaryBody<'a> {
    fn take(&mut self, count: usize) -> Option<&'a [u8]> {
        let (head, rest) = self.rest.split_at_checked(count)?;
        self.rest = rest;
        Some(head)
    }

    fn value(&mut self, scalar: Scalar) -> Option<f64> {
        let raw = self.take(scalar.size())?;
        Some(scalar.value(raw, self.is_big))
    }

    /// Bytes of the items of a list. A negative or fractional length counts as a truncated body.
    fn list(&mut self, length: Scalar, item: Scalar) -> Option<&'a [u8]> {
        let length = self.value(length).filter(|l| *l >= 0.0 && l.fract() == 0.0)?;
        self.take((length as usize).checked_mul(item.size())?)
    }
}
