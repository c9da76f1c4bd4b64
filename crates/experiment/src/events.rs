//! `Events`: values over steps as a TensorBoard event file. It contains the columns of `curve.csv` and
//! `validation.csv`. On resume it is rewritten from them with records of the same lengths, so that a running
//! TensorBoard continues to read.
//!
//! The file is a sequence of `TFRecord`s: length (u64), its checksum, the record, its checksum; little-endian. A record
//! is a protobuf `Event`: wall time (1), step (2), and the file version (3) or a `Summary` (5) of `Value`s (1) with a
//! tag (1) and a number (2).

use pwrfgs_core::files::write_atomically;
use pwrfgs_core::{Error, Result};
use std::fs::{File, OpenOptions};
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

/// Content of the first record.
const FILE_VERSION: &[u8] = b"brain.Event:2";

/// An open event file.
#[derive(Debug)]
pub(crate) struct Events {
    path: PathBuf,
    file: File,
}

impl Events {
    /// Creates or empties the file `path`, and writes the first record.
    pub(crate) fn create(path: &Path) -> Result<Self> {
        write_atomically(path, &[])?;
        let file = OpenOptions::new().append(true).open(path).map_err(|e| Error::write(path, e))?;
        let mut events = Self { path: path.into(), file };
        events.write(&[double_field(1, wall_time()), bytes_field(3, FILE_VERSION)].concat())?;
        Ok(events)
    }

    /// Appends one event that happened `ago` seconds ago, with one number per tag.
    pub(crate) fn push<T: AsRef<str>>(&mut self, step: u64, scalars: &[(T, f64)], ago: f64) -> Result<()> {
        let value = |(tag, value): &(T, f64)| {
            let number = [&[2 << 3 | FLOAT][..], &(*value as f32).to_le_bytes()].concat();
            bytes_field(1, &[bytes_field(1, tag.as_ref().as_bytes()), number].concat())
        };
        let summary = scalars.iter().map(value).collect::<Vec<_>>().concat();
        let step = [vec![2 << 3 | VARINT], encode_varint(step)].concat();
        self.write(&[double_field(1, wall_time() - ago), step, bytes_field(5, &summary)].concat())
    }

    /// Flushes the records to disk; called before each checkpoint.
    pub(crate) fn sync(&self) -> Result<()> {
        self.file.sync_data().map_err(|e| Error::write(&self.path, e))
    }

    /// Appends the record of an encoded event.
    fn write(&mut self, event: &[u8]) -> Result<()> {
        self.file.write_all(&frame_record(event)).map_err(|e| Error::write(&self.path, e))
    }
}

/// Returns the seconds since 1970.
fn wall_time() -> f64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0.0, |d| d.as_secs_f64())
}

/// Frames `data` as a `TFRecord`: length, its checksum, data, their checksum.
fn frame_record(data: &[u8]) -> Vec<u8> {
    let length = (data.len() as u64).to_le_bytes();
    [&length[..], &checksum(&length), data, &checksum(data)].concat()
}

/// Computes the masked CRC-32C of `TFRecord`: rotated, and shifted by a constant, so that checksums over checksums work.
fn checksum(bytes: &[u8]) -> [u8; 4] {
    // The polynomial of CRC-32C (Castagnoli), lowest bit first.
    let bit = |crc: u32, _| crc >> 1 ^ if crc & 1 == 1 { 0x82f6_3b78 } else { 0 };
    let crc = !bytes.iter().fold(!0, |crc, byte| (0..8).fold(crc ^ u32::from(*byte), bit));
    crc.rotate_right(15).wrapping_add(0xa282_ead8).to_le_bytes()
}

// Protobuf: a field begins with its number, shifted by three bits, and its wire type.
const VARINT: u8 = 0;
const DOUBLE: u8 = 1;
const LENGTH: u8 = 2;
const FLOAT: u8 = 5;

/// Encodes a protobuf integer of variable length: seven bits per byte, lowest first; the high bit marks that more follow.
fn encode_varint(mut value: u64) -> Vec<u8> {
    let mut out = Vec::new();
    while value >= 0x80 {
        out.push(value as u8 | 0x80);
        value >>= 7;
    }
    out.push(value as u8);
    out
}

/// Encodes the protobuf field `number` of double precision.
fn double_field(number: u8, value: f64) -> Vec<u8> {
    [&[number << 3 | DOUBLE][..], &value.to_le_bytes()].concat()
}

/// Encodes the protobuf field `number` of text or of a message.
fn bytes_field(number: u8, value: &[u8]) -> Vec<u8> {
    [&[number << 3 | LENGTH][..], &encode_varint(value.len() as u64), value].concat()
}

#[cfg(test)]
mod tests;
