//! The folder of an inspection: one page, and only its own is ever replaced.

use crate::Inspection;
use pwrfgs_core::files::{self, refuse_foreign, write_atomically};
use pwrfgs_core::{Error, Result};
use std::path::{Path, PathBuf};

/// The file.
const PAGE: &str = "inspect.html";
/// What stands near its beginning: by this a page is known to be ours.
pub(crate) const MARK: &str = "<meta name=\"generator\" content=\"pwrfgs inspect\">";
/// How far from the beginning the mark is looked for, bytes.
const HEAD: usize = 4_096;

/// Refuses a folder that holds anything but the page of an earlier inspection.
///
/// # Errors
/// [`Error::Config`] that says what stands there.
pub fn claim(out: &Path) -> Result<()> {
    let page = out.join(PAGE);
    for place in [out, &page] {
        if place.is_symlink() {
            let what = "is a symbolic link, and a page is never written through one; choose another --out";
            return Err(Error::Config(format!("{} {what}", place.display())));
        }
    }
    if !page.exists() {
        return refuse_foreign(out, "the folder of an inspection");
    }
    let bytes = files::read_at_most(&page, files::MAX_TEXT).map_err(|e| Error::read(&page, e))?;
    let head = String::from_utf8_lossy(&bytes[..bytes.len().min(HEAD)]);
    if head.contains(MARK) {
        return Ok(());
    }
    Err(Error::Config(format!("{} is no page of `pwrfgs inspect`; choose another --out", page.display())))
}

/// Writes `inspect.html` into the folder `out`, in place of the one of an earlier inspection; gives its path.
///
/// # Errors
/// As [`claim`], or where the disk refuses.
pub fn write(found: &Inspection<'_>, out: &Path) -> Result<PathBuf> {
    claim(out)?;
    let text = found.page()?;
    std::fs::create_dir_all(out).map_err(|e| Error::write(out, e))?;
    let page = out.join(PAGE);
    write_atomically(&page, text.as_bytes())?;
    Ok(page)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_page_of_ours_is_replaced() {
        let here = tempfile::tempdir().unwrap();
        let out = here.path().join("inspect-s23");
        claim(&out).unwrap();
        std::fs::create_dir(&out).unwrap();
        claim(&out).unwrap();
        std::fs::write(out.join(PAGE), format!("<!DOCTYPE html>\n{MARK}")).unwrap();
        claim(&out).unwrap();
        std::fs::write(out.join(PAGE), "my thesis").unwrap();
        let said = claim(&out).unwrap_err();
        assert!(said.is_input() && said.to_string().contains("is no page of `pwrfgs inspect`"), "{said}");
        std::fs::remove_file(out.join(PAGE)).unwrap();
        std::fs::write(out.join("thesis.tex"), "x").unwrap();
        assert!(claim(&out).unwrap_err().to_string().contains("(it holds `thesis.tex`)"));
        assert!(claim(&out.join("thesis.tex")).unwrap_err().is_input());
        #[cfg(unix)]
        {
            let link = here.path().join("link");
            std::os::unix::fs::symlink(&out, &link).unwrap();
            assert!(claim(&link).unwrap_err().to_string().contains("symbolic link"));
        }
    }
}
