//! Folder of the report: its files and their ownership.
//!
//! `report.json` lists the files of the report. Only these are replaced or removed, each atomically; a
//! non-empty folder without such a list is rejected.

use super::format;
use super::page::StudyPage;
use pwrfgs_core::files::{self, refuse_foreign, write_atomically};
use pwrfgs_core::{Error, Result};
use pwrfgs_experiment::{Observer, Study};
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::path::Path;

/// File that marks a folder as a report.
const OWN: &str = "report.json";

/// Content of [`OWN`].
#[derive(Debug, Default, PartialEq, Serialize, Deserialize)]
struct Owned {
    /// Version of pwrfgs.
    version: String,
    /// Paths inside the folder, in ascending order.
    files: BTreeSet<String>,
}

/// Writes the report of a study into `out`: `report.csv`, `report.tex` with `tables/`, `report.html` and
/// `figures/`. Returns the tables as text for a terminal. Paired differences are from the variant or baseline
/// `reference`, or from the first variant of each setting.
///
/// Equal runs give equal bytes.
///
/// # Errors
/// If the reference does not exist, the folder is not a report, or a file cannot be written.
pub fn write(study: &Study, reference: Option<&str>, out: &Path, observer: &mut dyn Observer) -> Result<String> {
    refuse_links(out)?;
    let before = owned(out)?;
    let page = StudyPage::new(study, reference, observer)?;
    let files = files(&page)?;
    let names: BTreeSet<String> = files.iter().map(|(name, _)| name.clone()).collect();
    if let Some(foreign) = names.difference(&before.files).find(|name| out.join(name).symlink_metadata().is_ok()) {
        let path = out.join(foreign);
        return Err(Error::Config(format!("{}: not a file of the report; choose another --out", path.display())));
    }
    for folder in ["tables", "figures"] {
        let folder = out.join(folder);
        std::fs::create_dir_all(&folder).map_err(|e| Error::write(&folder, e))?;
    }
    // First the list of all files, so that an interrupted report can be replaced.
    own(out, &before.files | &names)?;
    for (name, bytes) in &files {
        write_atomically(&out.join(name), bytes)?;
    }
    for old in before.files.difference(&names) {
        // The user may have removed the file already.
        _ = std::fs::remove_file(out.join(old));
    }
    // Removes the folder of figures if it is empty.
    _ = std::fs::remove_dir(out.join("figures"));
    own(out, names)?;
    Ok(format::text(&page))
}

/// Names and bytes of all files except [`OWN`].
fn files(page: &StudyPage) -> Result<Vec<(String, Vec<u8>)>> {
    let mut files = vec![("report.csv".into(), page.csv.clone().into())];
    files.extend(format::documents(page)?.into_iter().map(|(name, text)| (name, text.into())));
    for section in &page.sections {
        for figure in &section.figures {
            let stem = format!("figures/{}-{}", section.name, figure.name);
            files.push((format!("{stem}.svg"), figure.svg.clone().into()));
            files.push((format!("{stem}.pdf"), figure.pdf.clone()));
            files.push((format!("{stem}.png"), figure.png.clone()));
        }
    }
    Ok(files)
}

/// Rejects symbolic links: a report replaces and removes files, and only its own.
fn refuse_links(out: &Path) -> Result<()> {
    let places = [out.to_owned(), out.join(OWN), out.join("tables"), out.join("figures")];
    let leads_away = |place: &&std::path::PathBuf| place.symlink_metadata().is_ok_and(|found| found.is_symlink());
    places.iter().find(leads_away).map_or(Ok(()), |place| {
        let advice = "reports are not written through links; choose another --out";
        Err(Error::Config(format!("{}: symbolic link; {advice}", place.display())))
    })
}

/// List of files in `out`; empty for a new folder. Rejects paths that are not folders, and folders with files but
/// without a list of a report.
fn owned(out: &Path) -> Result<Owned> {
    let path = out.join(OWN);
    let Some(text) = files::if_found(&path, files::read_string(&path))? else {
        return refuse_foreign(out, "a report's folder").map(|()| Owned::default());
    };
    // Only names of report files: nothing else is removed, whatever the list contains.
    serde_json::from_str::<Owned>(&text)
        .ok()
        .filter(|list| list.files.iter().all(|name| is_ours(name)))
        .ok_or_else(|| Error::input(&path, "not a list of report files; choose another --out"))
}

/// Whether a report writes files of this name.
fn is_ours(name: &str) -> bool {
    let below = |folder: &str, ends: &[&str]| {
        name.strip_prefix(folder).is_some_and(|n| !n.contains(['/', '\\']) && ends.iter().any(|end| n.ends_with(end)))
    };
    ["report.csv", "report.tex", "report.html"].contains(&name)
        || below("tables/", &[".tex"])
        || below("figures/", &[".svg", ".pdf", ".png"])
}

fn own(out: &Path, files: BTreeSet<String>) -> Result<()> {
    let list = Owned { version: env!("CARGO_PKG_VERSION").into(), files };
    let text = serde_json::to_string_pretty(&list).expect("plain data") + "\n";
    write_atomically(&out.join(OWN), text.as_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn refuses_folder_that_is_not_a_report() {
        let folder = tempfile::tempdir().unwrap();
        owned(folder.path()).unwrap();
        owned(&folder.path().join("missing")).unwrap();
        std::fs::write(folder.path().join("thesis.tex"), "x").unwrap();
        let message = owned(folder.path()).unwrap_err();
        assert!(message.is_input() && message.to_string().contains("`thesis.tex`"), "{message}");
        assert!(owned(&folder.path().join("thesis.tex")).unwrap_err().is_input());
        own(folder.path(), BTreeSet::from(["report.csv".into()])).unwrap();
        owned(folder.path()).unwrap();
    }

    #[cfg(unix)]
    #[test]
    fn refuses_to_write_or_remove_through_symlink() {
        let (folder, elsewhere) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let precious = elsewhere.path().join("1-old.svg");
        std::fs::write(&precious, "mine").unwrap();
        own(folder.path(), BTreeSet::from(["figures/1-old.svg".to_owned()])).unwrap();
        own(elsewhere.path(), BTreeSet::new()).unwrap();
        let study = Study { title: "none".into(), ..Study::default() };
        let write = |out: &Path| write(&study, None, out, &mut pwrfgs_experiment::NoopObserver);
        let whole = |name: &str| {
            let link = folder.path().join(name);
            std::os::unix::fs::symlink(elsewhere.path(), &link).unwrap();
            link
        };
        for link in [whole("figures"), whole("tables")] {
            let message = write(folder.path()).unwrap_err();
            assert!(
                message.is_input() && message.to_string().contains("symbolic link; reports are not written"),
                "{message}"
            );
            std::fs::remove_file(link).unwrap();
        }
        assert!(write(&whole("report")).unwrap_err().is_input());
        assert_eq!(std::fs::read_to_string(&precious).unwrap(), "mine");
        // A link in place of a file is rejected if it is not listed; if it is listed, it is replaced and not followed.
        std::os::unix::fs::symlink(&precious, folder.path().join("report.csv")).unwrap();
        assert!(write(folder.path()).unwrap_err().to_string().contains("report.csv: not a file of the report"));
        own(folder.path(), BTreeSet::from(["report.csv".to_owned()])).unwrap();
        write(folder.path()).unwrap();
        assert!(!folder.path().join("report.csv").is_symlink());
        assert_eq!(std::fs::read_to_string(&precious).unwrap(), "mine");
    }

    #[test]
    fn rejects_file_list_with_foreign_paths() {
        for name in ["../../precious", "/etc/hosts", "tables/../../a.tex", "figures/x.gif", "notes.md"] {
            let folder = tempfile::tempdir().unwrap();
            own(folder.path(), BTreeSet::from([name.to_owned()])).unwrap();
            assert!(owned(folder.path()).unwrap_err().is_input(), "{name}");
        }
        assert!(is_ours("figures/1-ssim.svg") && is_ours("tables/2-scores.tex") && is_ours("report.csv"));
    }
}
