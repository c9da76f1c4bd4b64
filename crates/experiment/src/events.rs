//! `Events`: numbers over steps as a TensorBoard event file, cut back to the checkpoint when a run goes on.
//!
//! The file is a row of `TFRecord`s: length (u64), its checksum, the record, its checksum; little-endian. A record is a
//! protobuf `Event`: wall time (1), step (2), and the file version (3) or a `Summary` (5) of `Value`s (1) with a tag
//! (1) and a number (2).

use pwrfgs_core::{Error, Result, files};
use std::fs::{File, OpenOptions};
use std::io::{Read as _, Write as _};
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

/// What the first record says.
const FILE_VERSION: &[u8] = b"brain.Event:2";
/// Begins the tags of the final scores.
pub(crate) const TEST: &str = "test/";

/// An open event file.
#[derive(Debug)]
pub(crate) struct Events {
    path: PathBuf,
    file: File,
}

impl Events {
    /// Opens `path`, keeping the whole records up to step `done`. A record that a killed run left half-written is cut
    /// off, and so are the final scores: they come last and are written whenever they are computed. The file is cut in
    /// place: the steps that follow have the same length again, and a TensorBoard that was watching reads on.
    pub(crate) fn open(path: &Path, done: u64) -> Result<Self> {
        files::refuse_irregular(path).map_err(|e| Error::read(path, e))?;
        let mut file =
            (OpenOptions::new().read(true).append(true).create(true).open(path)).map_err(|e| Error::write(path, e))?;
        let mut old = Vec::new();
        file.read_to_end(&mut old).map_err(|e| Error::read(path, e))?;
        let kept = kept(&old, done);
        file.set_len(kept as u64).map_err(|e| Error::write(path, e))?;
        let mut events = Self { path: path.into(), file };
        if kept == 0 {
            events.write(&[number(1, wall_time()), bytes(3, FILE_VERSION)].concat())?;
        }
        Ok(events)
    }

    /// Appends one event with a number a tag.
    pub(crate) fn push<T: AsRef<str>>(&mut self, step: u64, scalars: &[(T, f64)]) -> Result<()> {
        let value = |(tag, value): &(T, f64)| {
            let number = [&[2 << 3 | FLOAT][..], &(*value as f32).to_le_bytes()].concat();
            bytes(1, &[bytes(1, tag.as_ref().as_bytes()), number].concat())
        };
        let summary = scalars.iter().map(value).collect::<Vec<_>>().concat();
        let step = [vec![2 << 3 | VARINT], varint(step)].concat();
        self.write(&[number(1, wall_time()), step, bytes(5, &summary)].concat())
    }

    /// Brings the records to the disk; called before each checkpoint.
    pub(crate) fn sync(&self) -> Result<()> {
        self.file.sync_data().map_err(|e| Error::write(&self.path, e))
    }

    fn write(&mut self, event: &[u8]) -> Result<()> {
        self.file.write_all(&record(event)).map_err(|e| Error::write(&self.path, e))
    }
}

/// Seconds since 1970.
fn wall_time() -> f64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0.0, |d| d.as_secs_f64())
}

/// How many bytes of an old file may stay.
fn kept(old: &[u8], done: u64) -> usize {
    let mut rest = old;
    let mut first = true;
    while let Some((event, tail)) = next_record(rest) {
        let stays = if first { is_version(event) } else { stays(event, done) };
        if stays != Some(true) {
            break;
        }
        (rest, first) = (tail, false);
    }
    old.len() - rest.len()
}

/// Whether an event is the one that a file begins with.
fn is_version(event: &[u8]) -> Option<bool> {
    Some(field(event, 3)? == Field::Bytes(FILE_VERSION))
}

/// Whether an event belongs to the training up to step `done`; `None` for what is no event of ours.
fn stays(event: &[u8], done: u64) -> Option<bool> {
    let (Field::Number(step), Field::Bytes(summary)) = (field(event, 2)?, field(event, 5)?) else { return None };
    let Field::Bytes(value) = field(summary, 1)? else { return None };
    let Field::Bytes(tag) = field(value, 1)? else { return None };
    Some(step <= done && !tag.starts_with(TEST.as_bytes()))
}

/// A `TFRecord`.
fn record(data: &[u8]) -> Vec<u8> {
    let length = (data.len() as u64).to_le_bytes();
    [&length[..], &checksum(&length), data, &checksum(data)].concat()
}

/// The record at the beginning of `bytes` and what follows; `None` where it is not whole.
fn next_record(bytes: &[u8]) -> Option<(&[u8], &[u8])> {
    let (length, rest) = bytes.split_at_checked(8)?;
    let (check, rest) = rest.split_at_checked(4)?;
    if check != checksum(length) {
        return None;
    }
    let length = usize::try_from(u64::from_le_bytes(length.try_into().ok()?)).ok()?;
    let (data, rest) = rest.split_at_checked(length)?;
    let (check, rest) = rest.split_at_checked(4)?;
    (check == checksum(data)).then_some((data, rest))
}

/// CRC-32C, turned and shifted as `TFRecord` has it: so that a checksum over checksums means something.
fn checksum(bytes: &[u8]) -> [u8; 4] {
    let bit = |crc: u32, _| crc >> 1 ^ if crc & 1 == 1 { 0x82f6_3b78 } else { 0 };
    let crc = !bytes.iter().fold(!0, |crc, byte| (0..8).fold(crc ^ u32::from(*byte), bit));
    crc.rotate_right(15).wrapping_add(0xa282_ead8).to_le_bytes()
}

// Protobuf: the low three bits of a field's key say how its value is written.
const VARINT: u8 = 0;
const DOUBLE: u8 = 1;
const LENGTH: u8 = 2;
const FLOAT: u8 = 5;

/// Seven bits a byte, the lowest first.
fn varint(mut value: u64) -> Vec<u8> {
    let mut out = Vec::new();
    while value >= 0x80 {
        out.push(value as u8 | 0x80);
        value >>= 7;
    }
    out.push(value as u8);
    out
}

/// A field of double precision.
fn number(key: u8, value: f64) -> Vec<u8> {
    [&[key << 3 | DOUBLE][..], &value.to_le_bytes()].concat()
}

/// A field of text or of a message.
fn bytes(key: u8, value: &[u8]) -> Vec<u8> {
    [&[key << 3 | LENGTH][..], &varint(value.len() as u64), value].concat()
}

#[derive(Debug, PartialEq)]
enum Field<'a> {
    Number(u64),
    Bytes(&'a [u8]),
}

/// The first field `key` of a message.
fn field(mut message: &[u8], key: u8) -> Option<Field<'_>> {
    while let Some((&head, rest)) = message.split_first() {
        let (value, rest) = match head & 7 {
            VARINT => read_varint(rest).map(|(value, rest)| (Field::Number(value), rest))?,
            DOUBLE => rest.split_at_checked(8).map(|(value, rest)| (Field::Bytes(value), rest))?,
            FLOAT => rest.split_at_checked(4).map(|(value, rest)| (Field::Bytes(value), rest))?,
            LENGTH => {
                let (length, rest) = read_varint(rest)?;
                rest.split_at_checked(usize::try_from(length).ok()?).map(|(v, rest)| (Field::Bytes(v), rest))?
            }
            _ => return None,
        };
        if head >> 3 == key {
            return Some(value);
        }
        message = rest;
    }
    None
}

fn read_varint(bytes: &[u8]) -> Option<(u64, &[u8])> {
    let end = bytes.iter().take(10).position(|byte| byte & 0x80 == 0)?;
    let (own, rest) = bytes.split_at(end + 1);
    Some((own.iter().rev().fold(0, |value, byte| value << 7 | u64::from(byte & 0x7f)), rest))
}

#[cfg(test)]
mod tests;
