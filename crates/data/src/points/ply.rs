//! PLY: a header, then elements as text or as binary of either byte order. Only `x`, `y`, `z` of `vertex` are kept, but
//! everything is walked through, so that a truncated file is noticed.
//!
//! Read here rather than with `ply-rs-bw`: that crate refuses blank lines and numbers such as `.5` and `nan` as syntax,
//! and its messages run over several lines.

mod header;
#[cfg(test)]
mod tests;

use crate::text::{Field, XyzColumns, lines, split_blanks};
use header::{Element, Encoding, Header, Kind, Scalar};
use pwrfgs_core::{Error, Real, Result};
use std::path::Path;

const ANEW: &str = "the file is cut short: copy it anew";
const ROW_ADVICE: &str = super::ROW_ADVICE;

/// The centres of all vertices.
pub(super) fn parse(path: &Path, bytes: &[u8]) -> Result<Vec<[Real; 3]>> {
    let header = Header::parse(path, bytes)?;
    match header.encoding {
        Encoding::Ascii => parse_ascii(path, &header, &bytes[header.bytes..]),
        Encoding::Little | Encoding::Big => parse_binary(path, &header, &bytes[header.bytes..]),
    }
}

fn parse_ascii(path: &Path, header: &Header, body: &[u8]) -> Result<Vec<[Real; 3]>> {
    let text = String::from_utf8_lossy(body);
    let mut rows = lines(&text).map(|(line, row)| (line + header.lines, row));
    let mut points = Vec::new();
    for (e, element) in header.elements.iter().enumerate().filter(|(_, element)| !element.properties.is_empty()) {
        for i in 0..element.count {
            let Some((line, row)) = rows.next() else {
                return Err(Error::input(path, ends(element, i)));
            };
            let fields = split_blanks(row);
            let starts = field_of_each_property(path, line, &fields, element)?;
            if e == header.vertex {
                let columns = XyzColumns(header.xyz.map(|property| starts[property]));
                points.push(columns.read(path, line, &fields, ROW_ADVICE)?);
            }
        }
    }
    Ok(points)
}

/// At which field of a row each property begins: a list takes as many fields as its first says, and that one.
fn field_of_each_property(path: &Path, line: usize, fields: &[Field<'_>], element: &Element) -> Result<Vec<usize>> {
    let mut starts = Vec::with_capacity(element.properties.len());
    let mut next = 0;
    for property in &element.properties {
        starts.push(next);
        let taken = match (property.kind, fields.get(next)) {
            (Kind::List { .. }, Some(field)) => {
                let length: Option<usize> = field.text.parse().ok();
                let fault = || format!("`{}` is not the length of a list; correct the row", field.text);
                length.ok_or_else(|| Error::at(path, line, field.column, fault()))?.saturating_add(1)
            }
            _ => 1,
        };
        next = next.saturating_add(taken);
    }
    if next > fields.len() {
        let end = fields.last().map_or(1, |f| f.column + f.text.chars().count());
        let what = format!("the row of element `{}` ends early; give every property of the header", element.name);
        return Err(Error::at(path, line, end, what));
    }
    Ok(starts)
}

fn parse_binary(path: &Path, header: &Header, body: &[u8]) -> Result<Vec<[Real; 3]>> {
    let mut body = Body { rest: body, is_big: header.encoding == Encoding::Big };
    let mut points = Vec::new();
    for (e, element) in header.elements.iter().enumerate().filter(|(_, element)| !element.properties.is_empty()) {
        for i in 0..element.count {
            let mut point = [0.0; 3];
            for (p, property) in element.properties.iter().enumerate() {
                match property.kind {
                    Kind::Scalar(scalar) => {
                        let value = body.value(scalar).ok_or_else(|| Error::input(path, ends(element, i)))?;
                        if let Some(k) = header.xyz.iter().position(|&xyz| e == header.vertex && xyz == p) {
                            point[k] = value as Real;
                        }
                    }
                    Kind::List { length, item } => {
                        body.skip_list(length, item).ok_or_else(|| Error::input(path, ends(element, i)))?;
                    }
                }
            }
            if e == header.vertex {
                if !point.iter().all(|v| v.is_finite()) {
                    let what = format!("vertex {} of {} is not finite; {ROW_ADVICE}", i + 1, element.count);
                    return Err(Error::input(path, what));
                }
                points.push(point);
            }
        }
    }
    Ok(points)
}

fn ends(element: &Element, done: usize) -> String {
    format!("ends after {done} of {} rows of element `{}`; {ANEW}", element.count, element.name)
}

/// What is left of a binary body. `None` says that it is too short.
struct Body<'a> {
    rest: &'a [u8],
    is_big: bool,
}

impl<'a> Body<'a> {
    fn take(&mut self, count: usize) -> Option<&'a [u8]> {
        let (head, rest) = self.rest.split_at_checked(count)?;
        self.rest = rest;
        Some(head)
    }

    fn value(&mut self, scalar: Scalar) -> Option<f64> {
        let raw = self.take(scalar.size())?;
        Some(scalar.value(raw, self.is_big))
    }

    /// A negative length counts as too long for the body.
    fn skip_list(&mut self, length: Scalar, item: Scalar) -> Option<()> {
        let length = self.value(length).filter(|l| *l >= 0.0)?;
        self.take((length as usize).checked_mul(item.size())?).map(|_| ())
    }
}
