//! PLY: a header, then elements as text or binary of either byte order. Only `x`, `y`, `z` of `vertex` and the corners
//! of `face` are kept; all elements are parsed, so that truncated files are detected.
//!
//! The parser is our own: `ply-rs-bw` rejects blank lines and numbers such as `.5` and `nan` as syntax errors, and its
//! messages have several lines.

mod header;
#[cfg(test)]
mod tests;

use crate::polygons::{Polygons, Triangles};
use crate::text::{POINT_ADVICE, TextField, TextRow, XyzColumns, numbered_lines, point_fault};
use header::{PlyElement, PlyEncoding, PlyHeader, PropertyKind, STRIPS, Scalar};
use pwrfgs_core::{Error, Result, messages::quoted};
use std::path::Path;

const INDEX_ADVICE: &str = "correct the index of the vertex";

/// Parses the positions of all vertices, `[V,3]`. Returns an error for a damaged or truncated file.
pub(crate) fn parse_points(path: &Path, bytes: &[u8]) -> Result<Vec<[f64; 3]>> {
    let header = PlyHeader::parse(path, bytes)?;
    Ok(BodyParser { path, header: &header, corners: None }.parse_body(&bytes[header.bytes..])?.vertices)
}

/// Parses the surface: vertices, and faces split into triangles. Returns an error for a damaged or truncated file, or one
/// without an element of faces.
pub(crate) fn parse_mesh(path: &Path, bytes: &[u8]) -> Result<Triangles> {
    let header = PlyHeader::parse(path, bytes)?;
    let corners = Some(header.find_corner_list(path)?);
    let contents = BodyParser { path, header: &header, corners }.parse_body(&bytes[header.bytes..])?;
    contents.polygons.triangulate(path, contents.vertices)
}

/// Parsed vertices and faces.
#[derive(Default)]
struct Contents {
    vertices: Vec<[f64; 3]>,
    polygons: Polygons,
    /// Indices of the corners of a face: a work buffer.
    indices: Vec<i64>,
}

/// Parser of the body, which follows the header.
struct BodyParser<'a> {
    path: &'a Path,
    header: &'a PlyHeader,
    /// Indices of the face element and of its corner property, if faces are read.
    corners: Option<(usize, usize)>,
}

impl BodyParser<'_> {
    /// Parses the body after the header: vertices, and faces if they are read. Returns an error for a body that is cut
    /// short or has surplus content, or for an invalid vertex or face.
    fn parse_body(&self, body: &[u8]) -> Result<Contents> {
        match self.header.encoding {
            PlyEncoding::Ascii => self.parse_ascii(body),
            PlyEncoding::Little | PlyEncoding::Big => self.parse_binary(body),
        }
    }

    /// Returns the elements that have properties, with their indices; rows of others have no content.
    fn filled_elements(&self) -> impl Iterator<Item = (usize, &PlyElement)> {
        self.header.elements.iter().enumerate().filter(|(_, element)| !element.properties.is_empty())
    }

    /// Returns the error for a body that ends after `rows` rows of an element.
    fn truncation_error(&self, element: &PlyElement, rows: usize) -> Error {
        let PlyElement { count, name, .. } = element;
        let problem = format!("ends after {rows} of {count} rows of element `{name}`");
        Error::input(self.path, format!("{problem}; the file is cut short: copy it again"))
    }

    /// Adds the corners of a row of `face`, or of `tristrips`, to `out`. Returns the problem with an invalid face.
    fn add_face(&self, corners: &[i64], out: &mut Polygons) -> Result<(), String> {
        let Self { header, corners: face, .. } = self;
        let is_strip = face.is_some_and(|(e, _)| header.elements[e].name == STRIPS);
        let push = if is_strip { Polygons::push_strips } else { Polygons::push };
        push(out, corners, header.elements[header.vertex].count)
    }

    /// Parses a body of text: one line per row. Returns the errors of [`Self::parse_body`].
    fn parse_ascii(&self, body: &[u8]) -> Result<Contents> {
        let Self { path, header, corners } = self;
        let text = String::from_utf8_lossy(body);
        let mut rows = numbered_lines(&text).map(|(line, content)| (line + header.lines, content));
        let mut contents = Contents::default();
        for (e, element) in self.filled_elements() {
            for i in 0..element.count {
                let row = rows.next().ok_or_else(|| self.truncation_error(element, i))?;
                let row = TextRow::split_at_blanks(path, row);
                let starts = property_starts(&row, element)?;
                if e == header.vertex {
                    let columns = XyzColumns(header.xyz.map(|property| starts[property]));
                    contents.vertices.push(columns.read(&row, POINT_ADVICE)?);
                }
                if let Some((_, property)) = corners.filter(|(face, _)| e == *face) {
                    let length = row.fields[starts[property]].text.parse().unwrap_or(0); // valid: see `property_starts`
                    let listed = row.fields[starts[property] + 1..].iter().take(length);
                    let corners = listed.map(|field| parse_index(&row, *field)).collect::<Result<Vec<i64>>>()?;
                    self.add_face(&corners, &mut contents.polygons).map_err(|fault| row.fault(1, fault))?;
                }
            }
        }
        match rows.next() {
            Some((line, _)) => Err(Error::at(path, line, 1, "a row more than the header counts; correct its counts")),
            None => Ok(contents),
        }
    }

    /// Parses a binary body. Returns the errors of [`Self::parse_body`].
    fn parse_binary(&self, body: &[u8]) -> Result<Contents> {
        let mut body = BinaryBody { unread: body, is_big: self.header.encoding == PlyEncoding::Big };
        let mut contents = Contents::default();
        for (e, element) in self.filled_elements() {
            for i in 0..element.count {
                let point = self.parse_row(&mut body, (e, i), &mut contents)?;
                if e == self.header.vertex {
                    if let Some(fault) = point_fault(point) {
                        let problem = format!("vertex {} of {} is {fault}; {POINT_ADVICE}", i + 1, element.count);
                        return Err(Error::input(self.path, problem));
                    }
                    contents.vertices.push(point);
                }
            }
        }
        match body.unread {
            [] | b"\n" | b"\r\n" => Ok(contents), // some programs end every file with a line end
            surplus => {
                let surplus = surplus.len();
                let problem = format!("{surplus} bytes follow the last row; correct the header's counts");
                Err(Error::input(self.path, problem))
            }
        }
    }

    /// Parses row `i` of element `e` and returns its coordinates, zero if it is no vertex; adds a face to `out`.
    /// Returns an error if the body ends before the row does, or for an invalid face.
    fn parse_row(&self, body: &mut BinaryBody<'_>, (e, i): (usize, usize), out: &mut Contents) -> Result<[f64; 3]> {
        let Self { path, header, corners } = self;
        let element = &header.elements[e];
        let mut point = [0.0; 3];
        for (p, property) in element.properties.iter().enumerate() {
            match property.kind {
                PropertyKind::Scalar(scalar) => {
                    let value = body.read_number(scalar).ok_or_else(|| self.truncation_error(element, i))?;
                    if let Some(k) = header.xyz.iter().position(|&xyz| e == header.vertex && xyz == p) {
                        point[k] = value;
                    }
                }
                PropertyKind::List { length, item } => {
                    let bytes = body.read_list(length, item).ok_or_else(|| self.truncation_error(element, i))?;
                    if *corners == Some((e, p)) {
                        let index = |raw| to_integer(item.to_number(raw, body.is_big)).unwrap_or(-1); // no index
                        out.indices.clear();
                        out.indices.extend(bytes.chunks_exact(item.size()).map(index));
                        let fault = |fault| Error::input(path, format!("row {} of `{}`: {fault}", i + 1, element.name));
                        self.add_face(&out.indices, &mut out.polygons).map_err(fault)?;
                    }
                }
            }
        }
        Ok(point)
    }
}

/// Returns the index of the first field of each property in a row: a list has a length field followed by that many fields.
/// Numbers that are not used are not parsed: some programs write `-nan(ind)`, or `255.0` as a `uchar`. Returns an error for
/// a row with too many or too few fields.
fn property_starts(row: &TextRow<'_>, element: &PlyElement) -> Result<Vec<usize>> {
    let mut starts = Vec::with_capacity(element.properties.len());
    let mut next = 0;
    for property in &element.properties {
        starts.push(next);
        let count = match (property.kind, row.fields.get(next)) {
            (PropertyKind::List { .. }, Some(field)) => {
                let fault = || format!("{} is not the length of a list; correct the row", quoted(field.text));
                let length = field.text.parse::<usize>().ok().ok_or_else(|| row.fault(field.column, fault()))?;
                length.saturating_add(1)
            }
            _ => 1,
        };
        next = next.saturating_add(count);
    }
    if let Some(field) = row.fields.get(next) {
        let problem = format!("{} is more than the properties of element `{}`", quoted(field.text), element.name);
        return Err(row.fault(field.column, problem + "; correct the row or the header"));
    }
    if next > row.fields.len() {
        let problem = format!("the row of element `{}` ends early; give every property of the header", element.name);
        return Err(row.fault(row.end_column(), problem));
    }
    Ok(starts)
}

/// Parses a whole number in a list of corners. Returns an error for other text, a fraction, or a number that is not
/// finite.
fn parse_index(row: &TextRow<'_>, field: TextField<'_>) -> Result<i64> {
    let value = row.number(field, INDEX_ADVICE)?;
    let fault = || row.fault(field.column, format!("{} is not whole; {INDEX_ADVICE}", quoted(field.text)));
    to_integer(value).ok_or_else(fault)
}

/// Converts a whole number to an integer; `None` for a fraction. Indices beyond 2^53 are out of range in any case.
fn to_integer(value: f64) -> Option<i64> {
    (value.fract() == 0.0).then_some(value as i64)
}

/// Remaining bytes of a binary body; reads return `None` at its end.
struct BinaryBody<'a> {
    unread: &'a [u8],
    is_big: bool,
}

impl<'a> BinaryBody<'a> {
    /// Reads `count` bytes; `None` at the end of the body, without reading.
    fn take_bytes(&mut self, count: usize) -> Option<&'a [u8]> {
        let (bytes, unread) = self.unread.split_at_checked(count)?;
        self.unread = unread;
        Some(bytes)
    }

    /// Reads one number of this type; `None` at the end of the body.
    fn read_number(&mut self, scalar: Scalar) -> Option<f64> {
        let raw = self.take_bytes(scalar.size())?;
        Some(scalar.to_number(raw, self.is_big))
    }

    /// Reads a list and returns the bytes of its items; `None` at the end of the body, and for a negative or fractional length.
    fn read_list(&mut self, length: Scalar, item: Scalar) -> Option<&'a [u8]> {
        let length = self.read_number(length).filter(|l| *l >= 0.0 && l.fract() == 0.0)?;
        self.take_bytes((length as usize).checked_mul(item.size())?)
    }
}
