//! `NewFolder`: a folder that is whole or not there.

use super::refuse_occupied;
use crate::{Error, Result};
use std::fs::{self, File};
use std::mem;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Marks a folder under way as ours. It is locked by whoever fills the folder: a killed program no longer holds it.
const LOCK: &str = ".pwrfgs-lock";
/// Most letters of the name that is being made: the rest of a long one is left out.
const LONGEST: usize = 60;
/// How often removing a folder is tried into which somebody still writes.
const ATTEMPTS: usize = 100;
/// Where a folder goes that is removed.
const GRAVE: &str = "removed";

/// Folders under way in this process.
static UNDER_WAY: Mutex<Vec<PathBuf>> = Mutex::new(Vec::new());

/// A folder under way: made beside its place as `.NAME.PID-K.tmp`, renamed when it is whole, removed when it is dropped
/// before. What a killed program left of the same name is removed when the next one begins.
#[derive(Debug)]
pub struct NewFolder {
    path: PathBuf,
    out: PathBuf,
    /// Held as long as the folder is under way; on a file system without locks it tells nobody.
    _lock: File,
}

impl NewFolder {
    /// Begins the folder that will be `out`.
    ///
    /// # Errors
    /// Where `out` holds something or is no name for a folder, or the disk refuses.
    pub fn begin(out: &Path) -> Result<Self> {
        if out.file_name().is_none() || out.is_symlink() {
            return Err(Error::input(out, "is no name for a new folder; choose another"));
        }
        refuse_occupied(out)?;
        Self::beside(out)
    }

    /// The same, whatever `out` holds: for something that goes away again.
    ///
    /// # Errors
    /// Where the disk refuses.
    pub fn beside(out: &Path) -> Result<Self> {
        static COUNT: AtomicUsize = AtomicUsize::new(0); // one process may make the same folder twice at once
        let parent = out.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let name = short_name(out);
        fs::create_dir_all(parent).map_err(|e| Error::write(parent, e))?;
        clear(parent, Some(&name));
        let mut folders = under_way();
        let k = COUNT.fetch_add(1, Ordering::Relaxed);
        let path = parent.join(format!(".{name}.{}-{k}.tmp", std::process::id()));
        let made = fs::create_dir(&path).and_then(|()| locked(&path));
        let lock = made.map_err(|e| Error::write(&path, e))?;
        folders.push(path.clone());
        Ok(Self { path, out: out.into(), _lock: lock })
    }

    /// Removes a folder that was published; it is renamed first, so that nobody finds half of it.
    ///
    /// # Errors
    /// Where the disk refuses.
    pub fn remove(folder: &Path) -> Result<()> {
        let grave = Self::beside(folder)?;
        fs::rename(folder, grave.path.join(GRAVE)).map_err(|e| Error::write(folder, e))
    }

    /// Removes what killed programs left in `parent`, of any name.
    pub fn clear(parent: &Path) {
        clear(parent, None);
    }

    /// Removes all folders under way of this process, which must end next: from here on, a thread that begins, publishes
    /// or drops a folder waits for ever.
    pub fn abandon_all() {
        let folders = under_way();
        for path in folders.iter() {
            // Whoever still writes into it makes that fail, until the folder is not there any more.
            _ = (0..ATTEMPTS).find(|_| fs::remove_dir_all(path).is_ok() || !path.exists());
        }
        mem::forget(folders); // still locked
    }

    /// Where its files are written.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Gives it its name. An empty folder there gives way.
    ///
    /// # Errors
    /// Where the disk refuses.
    pub fn publish(self) -> Result<()> {
        let refuse = |e| Error::write(&self.out, e);
        let _held = under_way(); // a folder that `abandon_all` empties must not get its name
        // Where it does not exist, or is not empty, the rename says what matters.
        let _ = fs::remove_dir(&self.out);
        fs::rename(&self.path, &self.out).map_err(refuse)?;
        fs::remove_file(self.out.join(LOCK)).map_err(refuse)
    }
}

impl Drop for NewFolder {
    fn drop(&mut self) {
        under_way().retain(|path| *path != self.path);
        let _ = fs::remove_dir_all(&self.path); // published: not there; else the next start tries again
    }
}

fn under_way() -> MutexGuard<'static, Vec<PathBuf>> {
    UNDER_WAY.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The lock of a new folder. It gets its name when it is locked: nobody sees it free.
fn locked(folder: &Path) -> std::io::Result<File> {
    let (new, own) = (folder.join(format!("{LOCK}.new")), folder.join(LOCK));
    let lock = File::create_new(&new)?;
    let _ = lock.try_lock(); // a file system without locks is no reason to refuse
    fs::rename(&new, &own)?;
    Ok(lock)
}

fn short_name(out: &Path) -> String {
    out.file_name().unwrap_or_default().to_string_lossy().chars().take(LONGEST).collect()
}

/// Removes folders `.NAME.PID-K.tmp` of one name, or of any, whose lock nobody holds.
fn clear(parent: &Path, name: Option<&str>) {
    for entry in fs::read_dir(parent).into_iter().flatten().flatten() {
        let path = entry.path();
        if !is_under_way(&entry.file_name().to_string_lossy(), name) || path.is_symlink() {
            continue;
        }
        if super::open(path.join(LOCK)).is_ok_and(|lock| lock.try_lock().is_ok()) {
            let _ = fs::remove_dir_all(&path); // in the way of nobody
        }
    }
}

/// Whether a file is called as folders under way are: of one name, or of any.
fn is_under_way(file: &str, name: Option<&str>) -> bool {
    let parts = || file.strip_prefix('.')?.strip_suffix(".tmp")?.rsplit_once('.');
    parts().is_some_and(|(found, middle)| {
        let is_number = |text: &str| !text.is_empty() && text.bytes().all(|b| b.is_ascii_digit());
        let is_ours = middle.split_once('-').is_some_and(|(pid, k)| is_number(pid) && is_number(k));
        is_ours && name.is_none_or(|name| name == found)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        let mut names: Vec<String> =
            fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    #[test]
    fn it_is_whole_or_not_there() {
        let here = tempfile::tempdir().unwrap();
        let out = here.path().join("a/data");
        let folder = NewFolder::begin(&out).unwrap();
        fs::write(folder.path().join("x"), "1").unwrap();
        assert!(!out.exists());
        drop(folder);
        assert!(names(&here.path().join("a")).is_empty());
        fs::create_dir(&out).unwrap(); // empty: it gives way
        let folder = NewFolder::begin(&out).unwrap();
        let again = NewFolder::begin(&out).unwrap(); // the same folder twice at once
        fs::write(folder.path().join("x"), "2").unwrap();
        folder.publish().unwrap();
        assert!(again.publish().is_err(), "the first is there");
        assert_eq!((names(&here.path().join("a")), names(&out)), (vec!["data".into()], vec!["x".into()]));
        assert!(NewFolder::begin(&out).unwrap_err().to_string().contains("is not empty (it holds `x`)"));
        assert!(NewFolder::begin(Path::new("/")).is_err());
        NewFolder::remove(&out).unwrap();
        assert!(names(&here.path().join("a")).is_empty());
        NewFolder::begin(&here.path().join("x".repeat(250))).unwrap().publish().unwrap();
    }

    /// In a process of its own, which no other test shares.
    #[test]
    fn nothing_is_published_once_all_is_abandoned() {
        const OUT: &str = "PWRFGS_TEST_ABANDONED";
        if let Some(out) = std::env::var_os(OUT) {
            let folder = NewFolder::begin(Path::new(&out)).unwrap();
            let path = folder.path().to_owned();
            NewFolder::abandon_all();
            assert!(!path.exists());
            fs::create_dir(&path).unwrap(); // by a thread that still writes into it
            std::thread::spawn(move || folder.publish());
            std::thread::sleep(std::time::Duration::from_millis(100));
            std::process::exit(i32::from(Path::new(&out).exists()));
        }
        let here = tempfile::tempdir().unwrap();
        let name = "files::new_folder::tests::nothing_is_published_once_all_is_abandoned";
        let mut own = std::process::Command::new(std::env::current_exe().unwrap());
        let ended = own.args(["--exact", name]).env(OUT, here.path().join("data")).status().unwrap();
        assert!(ended.success(), "{ended}");
    }

    #[test]
    fn what_a_killed_program_left_is_removed_and_nothing_else() {
        let here = tempfile::tempdir().unwrap();
        let left = |name: &str| {
            fs::create_dir(here.path().join(name)).unwrap();
            fs::write(here.path().join(name).join(LOCK), "").unwrap();
        };
        [".data.1-0.tmp", ".data.2-0.tmp", ".data.x-0.tmp", ".data.2-0.tmp.txt", ".data.7.tmp", ".other.1-3.tmp"]
            .into_iter()
            .for_each(left);
        fs::create_dir(here.path().join(".data.3-0.tmp")).unwrap(); // without a lock it is not known to be ours
        let busy = File::open(here.path().join(".data.2-0.tmp").join(LOCK)).unwrap();
        busy.lock().unwrap();
        NewFolder::begin(&here.path().join("data")).unwrap().publish().unwrap();
        let kept = [".data.2-0.tmp", ".data.2-0.tmp.txt", ".data.3-0.tmp", ".data.7.tmp", ".data.x-0.tmp"];
        assert_eq!(names(here.path()), [&kept[..], &[".other.1-3.tmp", "data"]].concat());
        NewFolder::clear(here.path());
        assert_eq!(names(here.path()), [&kept[..], &["data"]].concat());
    }
}
