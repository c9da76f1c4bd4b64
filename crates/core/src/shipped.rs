//! `ShippedFile` and `ShippedModel`: pipelines, experiments, scenes and trained models inside the program, which are used by
//! name.
//!
//! The facade `pwrfgs` registers the files of the repository; a program without it has none.

use crate::error::{Error, Result, did_you_mean};
use crate::files::{ReadLimit, read_text_at_most};
use std::path::Path;

/// Pipeline, experiment or scene of the repository, stored in the program.
#[derive(Debug)]
pub struct ShippedFile {
    /// Folder in the repository: [`Self::PIPELINES`], [`Self::EXPERIMENTS`] or [`Self::SCENES`].
    pub folder: &'static str,
    /// File name without extension.
    pub name: &'static str,
    /// Content of the file in the repository.
    pub source: &'static str,
}

inventory::collect!(ShippedFile);

impl ShippedFile {
    /// Folder of pipelines.
    pub const PIPELINES: &'static str = "pipelines";
    /// Folder of experiments.
    pub const EXPERIMENTS: &'static str = "experiments";
    /// Folder of scenes.
    pub const SCENES: &'static str = "scenes";

    /// Lists the files of `folder`, in the order of their names.
    pub fn all(folder: &str) -> Vec<&'static Self> {
        let mut files: Vec<_> = inventory::iter::<Self>().filter(|file| file.folder == folder).collect();
        files.sort_by_key(|file| file.name);
        files
    }

    /// Returns the shipped file of `folder` that is named `path`; `None` if there is none, or `base` holds a file of
    /// this name.
    pub fn find(folder: &str, base: &Path, path: &Path) -> Option<&'static Self> {
        let shipped = inventory::iter::<Self>().find(|file| file.folder == folder && path.as_os_str() == file.name)?;
        (!base.join(path).is_file()).then_some(shipped)
    }

    /// Returns the text of the file at `path`, within `limit`, or of the shipped file of this name if there is none.
    ///
    /// # Errors
    /// As [`read_text_at_most`]; the message for a missing file without extension suggests a shipped file.
    pub fn read(folder: &str, path: &Path, limit: impl Into<ReadLimit>) -> Result<String> {
        if let Some(file) = Self::find(folder, Path::new(""), path) {
            return Ok(file.text());
        }
        if path.is_dir() {
            return Err(Error::input(path, "is a folder; name a file"));
        }
        let files = Self::all(folder);
        if path.extension().is_some() || path.exists() || files.is_empty() {
            return read_text_at_most(path, limit);
        }
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        let hint = did_you_mean(&name, files.iter().map(|file| file.name));
        let problem = format!("no such file, and the program ships no file of this name in {folder}{hint}");
        Err(Error::input(path, problem))
    }

    /// Returns the content for use outside the repository: paths of shipped files become their names, and other paths lose `../`,
    /// because they began in a folder of the repository.
    pub fn text(&self) -> String {
        let mut text = self.source.to_owned();
        for Self { folder, name, .. } in inventory::iter::<Self>() {
            for path in [format!("../{folder}/{name}.ron"), format!("{folder}/{name}.ron")] {
                text = text.replace(&path, name);
            }
        }
        text.replace("\"../", "\"")
    }

    /// Returns the first sentence of the comment at the start of the file, without its full stop.
    pub fn purpose(&self) -> String {
        let lines = self.source.lines().map_while(|line| line.strip_prefix("//")).map(str::trim);
        let header = lines.collect::<Vec<_>>().join(" ");
        let end = [". ", "? "].iter().filter_map(|mark| header.find(mark)).min().map_or(header.len(), |end| end + 1);
        header[..end].trim_end_matches('.').to_owned()
    }
}

/// Trained model of the repository, stored in the program.
#[derive(Debug)]
pub struct ShippedModel {
    /// File name without extension.
    pub name: &'static str,
    /// Content and data, one line.
    pub purpose: &'static str,
    /// Shipped pipeline with the data, split, baselines and metrics of the model.
    pub pipeline: &'static str,
    /// Bytes of the model file in the repository.
    pub bytes: &'static [u8],
}

inventory::collect!(ShippedModel);

impl ShippedModel {
    /// Lists all models, in the order of their names.
    pub fn all() -> Vec<&'static Self> {
        let mut models: Vec<_> = inventory::iter::<Self>().collect();
        models.sort_by_key(|model| model.name);
        models
    }

    /// Returns the shipped model named `path`; `None` if there is none, or a file or folder of this name exists.
    pub fn find(path: &Path) -> Option<&'static Self> {
        inventory::iter::<Self>().find(|model| path.as_os_str() == model.name).filter(|_| !path.exists())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    inventory::submit! { ShippedFile {
        folder: "experiments",
        name: "asks",
        source: "// How large is N\n// at 1.5 m? Two rows.\nExperiment()",
    } }
    inventory::submit! { ShippedFile { folder: "scenes", name: "room", source: "(name: \"a room\")" } }
    inventory::submit! { ShippedFile {
        folder: "pipelines",
        name: "first",
        source: "// Trains on scenes/room.ron,\n// 1.5 m wide. More text.\nPipeline(\
                 data: Simulated(scene: \"../scenes/room.ron\"), root: \"../data/x\")",
    } }

    #[test]
    fn shipped_file_needs_no_repository() {
        let first = ShippedFile::find(ShippedFile::PIPELINES, Path::new(""), Path::new("first")).unwrap();
        assert!(first.text().ends_with("Pipeline(data: Simulated(scene: \"room\"), root: \"data/x\")"));
        assert!(first.text().starts_with("// Trains on room,"));
        assert_eq!(first.purpose(), "Trains on scenes/room.ron, 1.5 m wide");
        assert_eq!(ShippedFile::all(ShippedFile::SCENES).len(), 1);
        assert_eq!(ShippedFile::all(ShippedFile::EXPERIMENTS)[0].purpose(), "How large is N at 1.5 m?");
    }

    #[test]
    fn file_of_user_precedes_shipped_file() {
        let folder = tempfile::tempdir().unwrap();
        let find = || ShippedFile::find(ShippedFile::SCENES, folder.path(), Path::new("room"));
        std::fs::create_dir(folder.path().join("room")).unwrap();
        assert!(find().is_some(), "a folder of this name does not hide it");
        std::fs::remove_dir(folder.path().join("room")).unwrap();
        std::fs::write(folder.path().join("room"), "(name: \"mine\")").unwrap();
        assert!(find().is_none());
        let read = |path: &Path| ShippedFile::read(ShippedFile::SCENES, path, 100);
        assert_eq!(read(&folder.path().join("room")).unwrap(), "(name: \"mine\")");
        assert_eq!(read(Path::new("room")).unwrap(), "(name: \"a room\")");
        let missing = read(Path::new("rom")).unwrap_err();
        assert!(missing.is_input() && missing.to_string().contains("did you mean `room`?"), "{missing}");
        assert!(!read(Path::new("rom.ron")).unwrap_err().to_string().contains("ships"));
    }
}
