//! Digest of data in memory, and their storage in the folder of a run.

use super::Dataset;
use pwrfgs::data::{LINKS, save, write_links};
use pwrfgs_core::files::digest;
use pwrfgs_core::plugin::to_ron;
use pwrfgs_core::{Dataset as Data, Error, Result, recognise};
use std::path::Path;

impl Dataset {
    /// Writes the new folder `path`, unless an earlier call has written these data to it (its name is their digest);
    /// returns their source as RON. If no layout holds the data, the folder lists their links in the data set of which
    /// they are a part.
    pub(super) fn write_for_run(&self, path: &Path) -> Result<String> {
        let file = path.join(LINKS);
        let stored = || match &self.subset_of {
            Some((source, _)) if file.is_file() => Some(format!("Subset(data: {source}, links: {})", to_ron(&file))),
            _ => recognise(path).map(|source| to_ron(&source)),
        };
        if let Some(source) = stored() {
            return Ok(source);
        }
        let written = match (save(&self.data, path), &self.subset_of) {
            (Err(error), Some((_, links))) if error.is_input() => write_links(path, links),
            (saved, _) => saved.map(drop),
        };
        // Another process may have written it since.
        stored().ok_or_else(|| written.err().unwrap_or_else(|| Error::input(path, "is damaged; remove it")))
    }
}

/// Returns a digest of all columns of data, 16 hexadecimal digits.
pub(super) fn digest_of(data: &Data) -> Result<String> {
    let Data {
        title, scene, elevation, locations, links, observations, features, placed, official, simulation, ..
    } = data;
    let size = (observations.size(), observations.number(), observations.frequencies_hz());
    let details = (size, features, placed, official, simulation);
    let mut text = format!("{:?}", (title, scene, elevation, locations, links, details));
    (0..data.len()).for_each(|i| text += &digest(&observations.raw(i)));
    observations.check()?;
    Ok(digest(text.as_bytes())[..16].to_owned())
}
