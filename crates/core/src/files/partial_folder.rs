//! `PartialFolder`: a folder that several starts of one command fill.

use super::held::lock_unused;
use super::new_folder::{check_target, rename_to_target};
use super::{if_found, read_string, refuse_foreign, try_lock, write_new};
use crate::{Error, Result};
use std::fs::{self, File};
use std::path::{Path, PathBuf};

/// Request that the folder answers, one line per part. The process that fills the folder locks this file.
const REQUEST: &str = ".pwrfgs-request";

/// Folder `NAME.partial` next to its target `NAME`, renamed when complete. It survives the process: the next start with the same
/// request continues it, and nothing else removes it.
#[derive(Debug)]
pub struct PartialFolder {
    path: PathBuf,
    out: PathBuf,
    /// Lock, held while the folder is filled; without effect on file systems without locks.
    _lock: File,
}

impl PartialFolder {
    /// Begins the folder that will be `out`, or continues that of an earlier start. `request` has the name and the digest of
    /// each part of the request, such as `("positions", digest)`.
    ///
    /// # Errors
    /// `out` is a file, a link or a folder that is not empty, or has no folder name; the partial folder holds other files, or had
    /// another request; [`Error::Busy`] while another process fills it; writing fails.
    pub fn begin(out: &Path, request: &[(&str, String)]) -> Result<Self> {
        if let Some(_unused) = lock_unused(&out.join(REQUEST)) {
            let _ = fs::remove_file(out.join(REQUEST)); // the process was killed while it published the folder
        }
        check_target(out)?;
        let path = Self::path_for(out);
        let record = path.join(REQUEST);
        if !record.is_file() {
            refuse_foreign(&path, "a folder of unfinished output", "")?;
        }
        fs::create_dir_all(&path).map_err(|e| Error::write(&path, e))?;
        let lines: Vec<String> = request.iter().map(|(part, digest)| format!("{part} {digest}\n")).collect();
        write_new(&record, lines.concat().as_bytes())?;
        // Without a record, another process has just published the folder.
        let locked = if_found(&record, try_lock(&record))?.flatten();
        let lock = locked.ok_or_else(|| Error::Busy(path.clone()))?;
        let recorded = if_found(&record, read_string(&record))?.unwrap_or_default();
        let differs = |(line, _): &(&String, _)| !recorded.contains(line.as_str());
        let other: Vec<&str> = lines.iter().zip(request).filter(differs).map(|(_, (part, _))| *part).collect();
        if !other.is_empty() {
            return Err(Error::Config(format!(
                "{} holds unfinished output of other {}; repeat the command that began it, remove this folder, or choose \
                 another --out",
                path.display(),
                other.join(" and ")
            )));
        }
        Ok(Self { path, out: out.into(), _lock: lock })
    }

    /// Returns the path of the partial folder that will be `out`.
    pub fn path_for(out: &Path) -> PathBuf {
        let mut name = out.file_name().unwrap_or_default().to_owned();
        name.push(".partial");
        out.with_file_name(name)
    }

    /// Returns the path for writing its files.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Writes one of its files.
    ///
    /// # Errors
    /// [`Error::Write`] if the file cannot be written.
    pub fn put(&self, name: &str, bytes: impl AsRef<[u8]>) -> Result<()> {
        super::write(&self.path.join(name), bytes)
    }

    /// Renames the folder to its target. An empty folder at the target is replaced.
    ///
    /// # Errors
    /// Something has appeared at the target since [`Self::begin`]; renaming fails; the GPU has failed
    /// ([`device::check`](crate::device::check)).
    pub fn publish(self) -> Result<()> {
        rename_to_target(&self.path, &self.out, REQUEST)
    }

    /// Removes the folder of a request that cannot succeed, so that the next start begins anew.
    pub fn discard(self) {
        let _ = fs::remove_dir_all(&self.path); // if this fails, the next start reports its content
    }
}

#[cfg(test)]
mod tests {
    use super::super::NewFolder;
    use super::*;

    #[test]
    fn partial_folder_is_continued_by_the_same_request_only() {
        let parent = tempfile::tempdir().unwrap();
        let (out, partial) = (parent.path().join("out"), parent.path().join("out.partial"));
        let request = |positions: &str| [("models", "1".to_owned()), ("positions", positions.to_owned())];
        let first = PartialFolder::begin(&out, &request("a")).unwrap();
        first.put("x", "1").unwrap();
        assert!(matches!(PartialFolder::begin(&out, &request("a")), Err(Error::Busy(path)) if path == partial));
        drop(first);
        NewFolder::remove_abandoned(parent.path());
        NewFolder::begin(&out).unwrap();
        let message = PartialFolder::begin(&out, &request("b")).unwrap_err();
        let expected =
            "out.partial holds unfinished output of other positions; repeat the command that began it, remove";
        assert!(message.is_input() && message.to_string().contains(expected), "{message}");
        assert_eq!(fs::read(partial.join("x")).unwrap(), b"1");
        PartialFolder::begin(&out, &request("a")).unwrap().publish().unwrap();
        assert!(!partial.exists() && out.read_dir().unwrap().count() == 1 && out.join("x").exists());
        assert!(PartialFolder::begin(&out, &request("a")).unwrap_err().to_string().contains("is not empty"));
        // Killed before the folder lost its record, and a folder of somebody else.
        fs::write(out.join(REQUEST), "").unwrap();
        assert!(PartialFolder::begin(&out, &request("a")).is_err() && !out.join(REQUEST).exists());
        fs::create_dir(parent.path().join("b.partial")).unwrap();
        PartialFolder::begin(&parent.path().join("b"), &request("a")).unwrap().discard();
        fs::create_dir(parent.path().join("b.partial")).unwrap();
        fs::write(parent.path().join("b.partial/mine"), "").unwrap();
        let message = PartialFolder::begin(&parent.path().join("b"), &request("a")).unwrap_err().to_string();
        assert!(message.contains("b.partial is not a folder of unfinished output and not empty"), "{message}");
    }
}
