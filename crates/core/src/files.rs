//! File access: atomic writes, text with positions for errors, and protection of folders of other programs.

mod atomic;
mod held;
mod new_folder;
mod partial_folder;

pub use atomic::{check_new_file, create, remove, remove_temporaries, replace, write_atomically, write_new};
pub use held::{HeldFolder, lock, try_lock};
pub use new_folder::NewFolder;
pub use partial_folder::PartialFolder;

use crate::{Error, Result, check_memory};
use sha2::{Digest as _, Sha256};
use std::fs::{self, DirEntry, File, FileType, OpenOptions};
use std::io::{self, BufWriter, ErrorKind, Read as _, Seek as _, SeekFrom, Write as _};
use std::path::{Path, PathBuf};

/// Limit of a text file: its values take up to ten times its bytes.
pub const MAX_TEXT: ReadLimit = ReadLimit::Held(10);
/// Limit of a binary file that is read whole: its bytes and its numbers.
pub const MAX_NUMBERS: ReadLimit = ReadLimit::Held(2);

/// Limit of a file that is read whole.
#[derive(Clone, Copy, Debug)]
pub enum ReadLimit {
    /// Maximum size, bytes: of a format that people write, whose parser needs unknown memory.
    Bytes(u64),
    /// Memory that the reader holds per byte of the file, bytes; all of it must be available.
    Held(u64),
}

impl From<u64> for ReadLimit {
    fn from(bytes: u64) -> Self {
        Self::Bytes(bytes)
    }
}

impl ReadLimit {
    /// Rejects a file of `size` bytes beyond the limit.
    ///
    /// # Errors
    /// The message begins with a verb and has the next step; its subject is the file.
    pub fn check(self, size: u64) -> Result<(), String> {
        match self {
            Self::Bytes(limit) if size > limit => {
                Err(format!("is larger than the limit of {limit} bytes; check the path"))
            }
            Self::Bytes(_) => Ok(()),
            Self::Held(per_byte) => check_memory(size.saturating_mul(per_byte), "check the path, or split the file"),
        }
    }
}

/// Opens a file for reading. All readers of the toolkit use this function: opening a named pipe would otherwise block
/// until another process writes to it.
///
/// # Errors
/// The file does not exist, is a named pipe, a socket or a device, or cannot be opened. A folder fails at the latest
/// when it is read.
#[expect(clippy::disallowed_methods, reason = "this function checks the type of the file first")]
pub fn open(path: impl AsRef<Path>) -> io::Result<File> {
    let path = path.as_ref();
    // Reading a folder fails with a clear error.
    if !path.is_dir() {
        refuse_irregular(path)?;
    }
    File::open(path)
}

/// Rejects a `path` that exists but is not a regular file, such as a named pipe or a device.
///
/// # Errors
/// [`ErrorKind::InvalidInput`] for a named pipe, a socket, a device or a folder; the message gives the file type.
pub fn refuse_irregular(path: &Path) -> io::Result<()> {
    match fs::metadata(path) {
        Ok(metadata) if !metadata.is_file() => {
            let problem = format!("this is {}; give a regular file", describe_file_type(metadata.file_type()));
            Err(io::Error::new(ErrorKind::InvalidInput, problem))
        }
        _ => Ok(()),
    }
}

/// Describes the type of a file that is not regular, such as `a socket`.
fn describe_file_type(file_type: FileType) -> &'static str {
    #[cfg(unix)]
    {
        use std::os::unix::fs::FileTypeExt as _;
        if file_type.is_fifo() {
            return "a named pipe";
        } else if file_type.is_socket() {
            return "a socket";
        }
    }
    if file_type.is_dir() { "a folder" } else { "a device" }
}

/// Reads the bytes of a regular file within [`MAX_NUMBERS`].
///
/// # Errors
/// As [`read_at_most`].
pub fn read(path: impl AsRef<Path>) -> io::Result<Vec<u8>> {
    read_at_most(path.as_ref(), MAX_NUMBERS)
}

/// Reads the text of a regular file within [`MAX_TEXT`], unchanged. For files written by people, see [`read_text`].
///
/// # Errors
/// As [`read_at_most`], and for text that is not UTF-8.
pub fn read_string(path: impl AsRef<Path>) -> io::Result<String> {
    String::from_utf8(read_at_most(path.as_ref(), MAX_TEXT)?)
        .map_err(|e| io::Error::new(ErrorKind::InvalidData, e.utf8_error()))
}

/// Reads the bytes of a regular file.
///
/// # Errors
/// The file cannot be opened or read, is not regular ([`open`]), or exceeds the `limit`.
pub fn read_at_most(path: &Path, limit: impl Into<ReadLimit>) -> io::Result<Vec<u8>> {
    let (file, limit) = (open(path)?, limit.into());
    let size = file.metadata()?.len(); // 0 for some files of the system
    let check = |size| {
        let refuse = |problem| io::Error::new(ErrorKind::FileTooLarge, format!("the file {problem}"));
        limit.check(size).map_err(refuse)
    };
    check(size)?;
    let mut bytes = Vec::new();
    bytes.try_reserve_exact(size as usize)?;
    // Files of the system, of size 0, may hold 256 MiB.
    let most = if let ReadLimit::Bytes(limit) = limit { limit } else { size.max(1 << 28) };
    file.take(most.saturating_add(1)).read_to_end(&mut bytes)?;
    check(bytes.len() as u64).map(|()| bytes)
}

/// Rejects a path at which neither a file nor a folder can be created: below a file, at or below a broken link, or with
/// a name that the file system rejects. Missing folders are accepted. A file or folder at `path` itself is not checked.
///
/// # Errors
/// [`Error::Input`] for such a path; the message names its invalid part.
pub fn check_path(path: &Path) -> Result<()> {
    let refuse = |problem: String| Err(Error::input(path, format!("{problem}; choose another path")));
    let mut missing = Vec::new();
    for ancestor in path.ancestors() {
        let folder = if ancestor.as_os_str().is_empty() { Path::new(".") } else { ancestor };
        match fs::metadata(folder) {
            Ok(metadata) if metadata.is_dir() => {
                // The file system rejects a long name only in a folder that exists.
                let fault = |name| fs::symlink_metadata(folder.join(name)).err().filter(is_invalid_name);
                return missing.iter().find_map(fault).map_or(Ok(()), |e| refuse(e.to_string()));
            }
            Ok(_) if ancestor == path => return Ok(()),
            Ok(_) => return refuse(format!("`{}` is not a folder", ancestor.display())),
            Err(_) if ancestor.is_symlink() => return refuse(format!("the link `{}` is broken", ancestor.display())),
            Err(e) if is_invalid_name(&e) => return refuse(e.to_string()),
            Err(_) => missing.extend(ancestor.file_name()),
        }
    }
    Ok(())
}

/// Returns whether an error says that the file system rejects the name itself.
fn is_invalid_name(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::InvalidFilename | ErrorKind::InvalidInput)
}

/// Returns the folder of a file, `.` for a name alone.
fn parent(path: &Path) -> &Path {
    path.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// Rejects a path at which no file can be created: as [`check_path`], and the folder of the file must exist.
///
/// # Errors
/// [`Error::Input`] for such a path, or if it is a folder; the message names the missing folder.
pub fn check_file_path(path: &Path) -> Result<()> {
    check_path(path)?;
    let parent = parent(path);
    if path.is_dir() || path.file_name().is_none() {
        return Err(Error::input(path, "is a folder; choose the name of a file"));
    }
    if parent.is_dir() {
        return Ok(());
    }
    let problem = format!("the folder `{}` does not exist", parent.display());
    Err(Error::input(path, format!("{problem}; create it, or choose another path")))
}

/// Writes a file of a folder that no other process reads yet.
///
/// # Errors
/// [`Error::Write`] if the file cannot be written.
pub fn write(path: &Path, bytes: impl AsRef<[u8]>) -> Result<()> {
    fs::write(path, bytes).map_err(|e| Error::write(path, e))
}

/// File that is written in parts, in a folder that no other process reads yet; it may exceed memory.
#[derive(Debug)]
pub struct GrowingFile {
    path: PathBuf,
    file: BufWriter<File>,
}

impl GrowingFile {
    /// Creates or replaces the file, with the first bytes `start`.
    ///
    /// # Errors
    /// [`Error::Write`] if the file cannot be written.
    pub fn create(path: PathBuf, start: &[u8]) -> Result<Self> {
        Self::resume(path, start, 0)
    }

    /// Opens the file to append after its first `length` bytes, which it must have, and drops later ones. If `length` is 0,
    /// creates the file with the bytes `start`.
    ///
    /// # Errors
    /// [`Error::Write`] if the file cannot be written.
    pub fn resume(path: PathBuf, start: &[u8], length: u64) -> Result<Self> {
        let open = || {
            let mut file = OpenOptions::new().write(true).create(true).truncate(length == 0).open(&path)?;
            file.set_len(length)?;
            file.seek(SeekFrom::End(0)).map(|_| file)
        };
        let file = open().map_err(|e| Error::write(&path, e))?;
        let mut growing = Self { file: BufWriter::with_capacity(1 << 20, file), path };
        growing.append(if length == 0 { start } else { &[] }).map(|()| growing)
    }

    /// Appends bytes.
    ///
    /// # Errors
    /// [`Error::Write`] if the file cannot be written.
    pub fn append(&mut self, bytes: &[u8]) -> Result<()> {
        self.file.write_all(bytes).map_err(|e| Error::write(&self.path, e))
    }

    /// Writes the buffered bytes.
    ///
    /// # Errors
    /// [`Error::Write`] if the file cannot be written.
    pub fn flush(&mut self) -> Result<()> {
        self.file.flush().map_err(|e| Error::write(&self.path, e))
    }

    /// Writes the buffered bytes of a complete file.
    ///
    /// # Errors
    /// [`Error::Write`] if the file cannot be written.
    pub fn finish(mut self) -> Result<()> {
        self.flush()
    }
}

/// Returns the SHA-256 of `bytes` in the notation of `sha256sum`: 64 hexadecimal digits.
pub fn digest(bytes: &[u8]) -> String {
    let digits = Sha256::digest(bytes);
    digits.iter().fold(String::with_capacity(64), |text, byte| text + &format!("{byte:02x}"))
}

/// Returns the content that was read from `path`; `None` if the file does not exist.
///
/// # Errors
/// [`Error::Read`] if the file cannot be read.
pub fn if_found<T>(path: &Path, read: io::Result<T>) -> Result<Option<T>> {
    match read {
        Ok(content) => Ok(Some(content)),
        Err(e) if [ErrorKind::NotFound, ErrorKind::NotADirectory].contains(&e.kind()) => Ok(None),
        Err(e) => Err(Error::read(path, e)),
    }
}

/// Reads a text file written by a person: UTF-8, with or without a byte order mark, within [`MAX_TEXT`].
///
/// # Errors
/// The file cannot be read, exceeds the limit, or is not UTF-8.
pub fn read_text(path: &Path) -> Result<String> {
    read_text_at_most(path, MAX_TEXT)
}

/// Reads a text file as [`read_text`] does, with another `limit`.
///
/// # Errors
/// The file cannot be read, exceeds the limit, or is not UTF-8.
pub fn read_text_at_most(path: &Path, limit: impl Into<ReadLimit>) -> Result<String> {
    let text = String::from_utf8(read_at_most(path, limit).map_err(|e| Error::read(path, e))?).map_err(|e| {
        let line = e.as_bytes()[..e.utf8_error().valid_up_to()].split(|b| *b == b'\n').count();
        Error::at(path, line, 1, "this is not text; save the file as UTF-8")
    })?;
    Ok(text.strip_prefix('\u{feff}').map(str::to_owned).unwrap_or(text))
}

/// Rejects a folder with foreign content, that is anything except temporary files and empty folders of a killed first
/// write, and the entry called `accepted`. `expected` names the type of the folder in the message, such as `a run folder`. A
/// missing folder is accepted.
///
/// # Errors
/// [`Error::Config`] for a folder with foreign content, which the message names, for an empty path, or for a file;
/// [`Error::Input`] for an invalid path ([`check_path`]); [`Error::Read`] if the folder cannot be read.
pub fn refuse_foreign(folder: &Path, expected: &str, accepted: &str) -> Result<()> {
    let is_leftover = |entry: &DirEntry| {
        let path = entry.path();
        entry.file_name() == accepted
            || path.extension().is_some_and(|e| e == "tmp")
            || path.read_dir().is_ok_and(|mut e| e.next().is_none())
    };
    match read_entries(folder)?.into_iter().find(|entry| !is_leftover(entry)) {
        None => Ok(()),
        Some(entry) => {
            Err(Error::Config(format!("{} is not {expected} and {}", folder.display(), describe_occupied(&entry))))
        }
    }
}

/// Rejects a folder that is not empty; a missing folder is accepted.
///
/// # Errors
/// [`Error::Config`] for a folder that is not empty; the message names a file in it. Otherwise as [`refuse_foreign`].
pub fn refuse_occupied(folder: &Path) -> Result<()> {
    match read_entries(folder)?.first() {
        None => Ok(()),
        Some(entry) => Err(Error::Config(format!("{} is {}", folder.display(), describe_occupied(entry)))),
    }
}

/// Describes a folder that holds `entry`, with the next step: the end of an error.
fn describe_occupied(entry: &DirEntry) -> String {
    format!("not empty (it holds `{}`); choose another --out", entry.file_name().to_string_lossy())
}

/// Reads the entries of a folder; none if it does not exist.
///
/// # Errors
/// The path is empty, leads to a file, or cannot be created ([`check_path`]), or the folder cannot be read.
fn read_entries(folder: &Path) -> Result<Vec<DirEntry>> {
    let folder = folder.components().as_path(); // without a trailing slash, which hides that it is a file
    match fs::read_dir(folder) {
        // An empty path would be the current directory.
        Err(_) if folder.as_os_str().is_empty() => {
            Err(Error::Config("the path of the folder is empty; give a path".into()))
        }
        Ok(entries) => Ok(entries.flatten().collect()),
        Err(_) if !folder.exists() => check_path(folder).map(|()| Vec::new()),
        Err(e) if e.kind() == ErrorKind::NotADirectory => {
            Err(Error::Config(format!("{} is not a folder; choose another --out", folder.display())))
        }
        Err(e) => Err(Error::read(folder, e)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn digest_matches_sha256sum() {
        assert_eq!(digest(b"abc"), "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
    }

    #[test]
    fn strips_byte_order_mark_and_rejects_binary() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.ron");
        fs::write(&path, b"\xef\xbb\xbfx").unwrap();
        assert_eq!(read_text(&path).unwrap(), "x");
        fs::write(&path, b"x\n\xff").unwrap();
        let message = read_text(&path).unwrap_err().to_string();
        assert_eq!(message, format!("{}:2:1: this is not text; save the file as UTF-8", path.display()));
    }

    #[test]
    fn reads_only_regular_files_of_limited_size() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        fs::write(&path, "12345").unwrap();
        assert_eq!(read_at_most(&path, 5).unwrap(), b"12345");
        assert_eq!(read_string(&path).unwrap(), "12345");
        assert_eq!(read_at_most(&path, 4).unwrap_err().kind(), ErrorKind::FileTooLarge);
        assert_eq!(read(folder.path()).unwrap_err().kind(), ErrorKind::IsADirectory);
        assert_eq!(read(folder.path().join("b")).unwrap_err().kind(), ErrorKind::NotFound);
        assert!(!read_at_most(Path::new("/proc/self/status"), 1 << 20).unwrap_or(vec![1]).is_empty());
        assert!(read_at_most(Path::new("/proc/self/status"), 9).is_err());
        #[cfg(unix)]
        {
            let pipe = folder.path().join("pipe");
            assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
            assert!(read(&pipe).unwrap_err().to_string().contains("this is a named pipe; give a regular file"));
            assert!(refuse_irregular(&pipe).is_err() && refuse_irregular(&path).is_ok());
            let _socket = std::os::unix::net::UnixListener::bind(folder.path().join("s")).unwrap();
            assert!(read(folder.path().join("s")).unwrap_err().to_string().contains("a socket"));
            assert!(read(Path::new("/dev/zero")).unwrap_err().to_string().contains("a device"));
        }
    }

    #[test]
    fn refuses_folder_with_other_files() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("out");
        refuse_foreign(&out, "a run folder", "data").unwrap();
        fs::create_dir_all(out.join("figures")).unwrap();
        fs::write(out.join(".report.md.7.tmp"), "half").unwrap();
        fs::create_dir_all(out.join("data").join("mine")).unwrap();
        refuse_foreign(&out, "a run folder", "data").unwrap();
        fs::write(out.join("thesis.tex"), "x").unwrap();
        let message = refuse_foreign(&out, "a run folder", "data").unwrap_err();
        assert!(message.is_input() && message.to_string().contains("(it holds `thesis.tex`)"), "{message}");
        assert!(
            refuse_foreign(&out.join("thesis.tex"), "a run folder", "data")
                .unwrap_err()
                .to_string()
                .contains("not a folder")
        );
        fs::remove_file(out.join("thesis.tex")).unwrap();
        refuse_foreign(&out, "a run folder", "data").unwrap();
        let message = refuse_occupied(&out).unwrap_err();
        assert!(message.is_input() && message.to_string().contains("is not empty (it holds `"), "{message}");
        refuse_occupied(&out.join("figures")).unwrap();
        refuse_occupied(&out.join("missing")).unwrap();
    }
}
