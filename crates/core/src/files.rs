//! Files as everything here treats them: written whole or not at all, text with a place for its faults, and folders that
//! are never taken from somebody else.

use crate::{Error, Result};
use std::fs::{self, DirEntry, File};
use std::io::{ErrorKind, Write as _};
use std::path::Path;

/// Writes a file so that at every instant either the old or the whole new one is there: a temporary file in the same
/// folder, synced, then renamed.
///
/// # Errors
/// [`Error::Write`]; the old file is then untouched.
pub fn write_atomically(path: &Path, bytes: &[u8]) -> Result<()> {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let temporary = path.with_file_name(format!(".{name}.{}.tmp", std::process::id()));
    let written = (|| {
        // What stands there is left of a killed process, or a link that somebody else laid: neither is written to.
        let _ = fs::remove_file(&temporary);
        let mut file = File::create_new(&temporary)?;
        file.write_all(bytes)?;
        file.sync_all()?;
        fs::rename(&temporary, path)?;
        // The rename itself lasts only once the folder is on disk; a file system that cannot sync folders still has it.
        if let Some(folder) = path.parent().filter(|p| !p.as_os_str().is_empty()) {
            let _ = File::open(folder).and_then(|folder| folder.sync_all());
        }
        Ok(())
    })();
    written.map_err(|e| {
        let _ = fs::remove_file(&temporary);
        Error::write(path, e)
    })
}

/// A text file as a person writes it: UTF-8, with or without a byte order mark.
///
/// # Errors
/// Where it cannot be read, or is no such text.
pub fn read_text(path: &Path) -> Result<String> {
    let text = String::from_utf8(fs::read(path).map_err(|e| Error::read(path, e))?).map_err(|e| {
        let line = e.as_bytes()[..e.utf8_error().valid_up_to()].split(|b| *b == b'\n').count();
        Error::at(path, line, 1, "this is not text; save the file as UTF-8")
    })?;
    Ok(text.strip_prefix('\u{feff}').map(str::to_owned).unwrap_or(text))
}

/// Refuses a folder that holds anything but what a killed first write of ours leaves there: temporary files and empty
/// folders. `what` it would have to be, such as `a run folder`, is said; one that does not exist is fine.
///
/// # Errors
/// [`Error::Config`] that names what stands there.
pub fn refuse_foreign(folder: &Path, what: &str) -> Result<()> {
    let is_left = |entry: &DirEntry| {
        let path = entry.path();
        path.extension().is_some_and(|e| e == "tmp") || path.read_dir().is_ok_and(|mut e| e.next().is_none())
    };
    match entries(folder)?.into_iter().find(|entry| !is_left(entry)) {
        None => Ok(()),
        Some(entry) => Err(Error::Config(format!("{} is not {what} and {}", folder.display(), holds(&entry)))),
    }
}

/// Refuses a folder that holds anything at all; one that does not exist is fine.
///
/// # Errors
/// [`Error::Config`] that names what stands there.
pub fn refuse_occupied(folder: &Path) -> Result<()> {
    match entries(folder)?.first() {
        None => Ok(()),
        Some(entry) => Err(Error::Config(format!("{} is {}", folder.display(), holds(entry)))),
    }
}

fn holds(entry: &DirEntry) -> String {
    format!("not empty (it holds `{}`); choose another --out", entry.file_name().to_string_lossy())
}

/// What a folder holds; nothing where it does not exist.
fn entries(folder: &Path) -> Result<Vec<DirEntry>> {
    match fs::read_dir(folder) {
        Ok(entries) => Ok(entries.flatten().collect()),
        // Where it lies below a file, making it will say why it fails.
        Err(_) if !folder.exists() => Ok(Vec::new()),
        Err(e) if e.kind() == ErrorKind::NotADirectory => {
            Err(Error::Config(format!("{} is no folder; choose another --out", folder.display())))
        }
        Err(e) => Err(Error::read(folder, e)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_replaced_whole_and_leaves_nothing_beside_it() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.txt");
        write_atomically(&path, b"old").unwrap();
        write_atomically(&path, b"new").unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"new");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
        assert!(!write_atomically(&folder.path().join("missing/a.txt"), b"").unwrap_err().is_input());
        #[cfg(unix)]
        {
            let precious = folder.path().join("precious");
            fs::write(&precious, "mine").unwrap();
            let temporary = folder.path().join(format!(".a.txt.{}.tmp", std::process::id()));
            std::os::unix::fs::symlink(&precious, &temporary).unwrap();
            write_atomically(&path, b"newest").unwrap();
            assert_eq!((fs::read(&precious).unwrap(), fs::read(&path).unwrap()), (b"mine".into(), b"newest".into()));
        }
    }

    #[test]
    fn a_byte_order_mark_is_dropped_and_binary_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.ron");
        fs::write(&path, b"\xef\xbb\xbfx").unwrap();
        assert_eq!(read_text(&path).unwrap(), "x");
        fs::write(&path, b"x\n\xff").unwrap();
        let said = read_text(&path).unwrap_err().to_string();
        assert_eq!(said, format!("{}:2:1: this is not text; save the file as UTF-8", path.display()));
    }

    #[test]
    fn a_folder_of_somebody_else_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("out");
        refuse_foreign(&out, "a run folder").unwrap();
        fs::create_dir_all(out.join("figures")).unwrap();
        fs::write(out.join(".report.md.7.tmp"), "half").unwrap();
        refuse_foreign(&out, "a run folder").unwrap();
        fs::write(out.join("thesis.tex"), "x").unwrap();
        let said = refuse_foreign(&out, "a run folder").unwrap_err();
        assert!(said.is_input() && said.to_string().contains("(it holds `thesis.tex`)"), "{said}");
        assert!(refuse_foreign(&out.join("thesis.tex"), "a run folder").unwrap_err().to_string().contains("no folder"));
        fs::remove_file(out.join("thesis.tex")).unwrap();
        refuse_foreign(&out, "a run folder").unwrap();
        let said = refuse_occupied(&out).unwrap_err();
        assert!(said.is_input() && said.to_string().contains("is not empty (it holds `"), "{said}");
        refuse_occupied(&out.join("figures")).unwrap();
        refuse_occupied(&out.join("missing")).unwrap();
    }
}
