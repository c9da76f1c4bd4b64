//! `Stored`: a file that stays open, read at any place from any thread.
//!
//! Reads at a position, and no memory map: as fast (a picture is copied once, in microseconds, and then worked on for
//! milliseconds), without unsafe code, not counted as virtual memory, and a file that is cut short is an error and not a
//! signal that kills.

use crate::{Error, Result};
use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

/// The bytes of a file from an offset on.
#[derive(Debug)]
pub(super) struct Stored {
    file: File,
    path: PathBuf,
    offset: u64,
    /// Of the whole file, bytes.
    pub(super) len: u64,
    /// The first read that failed.
    fault: OnceLock<(io::ErrorKind, String)>,
}

impl Stored {
    pub(super) fn open(path: &Path, offset: u64) -> Result<Self> {
        let refuse = |e| Error::read(path, e);
        let file = crate::files::open(path).map_err(refuse)?;
        let len = file.metadata().map_err(refuse)?.len();
        Ok(Self { file, path: path.into(), offset, len, fault: OnceLock::new() })
    }

    /// All of it.
    pub(super) fn all(&self) -> Result<Vec<u8>> {
        let read = || {
            let (mut bytes, len) = (Vec::new(), (self.len - self.offset) as usize);
            bytes.try_reserve_exact(len)?;
            bytes.resize(len, 0);
            read_exact_at(&self.file, &mut bytes, self.offset).map(|()| bytes)
        };
        read().map_err(|e| Error::read(&self.path, e))
    }

    /// `len` bytes from `start` on; zeros where they cannot be read, which [`Self::check`] tells.
    pub(super) fn part(&self, start: u64, len: usize) -> Vec<u8> {
        let mut bytes = vec![0; len];
        if let Err(e) = read_exact_at(&self.file, &mut bytes, self.offset + start) {
            let _ = self.fault.set((e.kind(), e.to_string())); // only the first is told
            bytes.fill(0);
        }
        bytes
    }

    pub(super) fn check(&self) -> Result<()> {
        match self.fault.get() {
            None => Ok(()),
            Some((kind, why)) => {
                let why = format!("{why}; the spectra have changed or gone since they were opened: put them back");
                Err(Error::read(&self.path, io::Error::new(*kind, why)))
            }
        }
    }
}

#[cfg(unix)]
fn read_exact_at(file: &File, bytes: &mut [u8], offset: u64) -> io::Result<()> {
    std::os::unix::fs::FileExt::read_exact_at(file, bytes, offset)
}

#[cfg(windows)]
fn read_exact_at(file: &File, mut bytes: &mut [u8], mut offset: u64) -> io::Result<()> {
    while !bytes.is_empty() {
        match std::os::windows::fs::FileExt::seek_read(file, bytes, offset)? {
            0 => return Err(io::ErrorKind::UnexpectedEof.into()),
            n => (bytes, offset) = (&mut bytes[n..], offset + n as u64),
        }
    }
    Ok(())
}
