//! `Subset`: some links of another data source.

use crate::Nerf2Spectrum;
use crate::folder::{format_lines, read_ascending};
use pwrfgs_core::files::{NewFolder, write};
use pwrfgs_core::{DataSource, Dataset, Error, JsonSchema, Plugin, Progress, Result, Task};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Name of the file that [`write_links`] writes.
pub const LINKS: &str = "links.txt";

/// Some links of another data source, with the IDs and bounds of the whole. A run in Python on a subset of data that no folder
/// of its own can hold, such as camera images, writes one.
///
/// ```
/// # use pwrfgs_core::{DataSource, Plugin};
/// # use pwrfgs_data as _;
/// let text = r#"Subset(data: Colmap(root: "data/room"), links: "links.txt")"#;
/// assert!(Plugin::<dyn DataSource>::parse(text).is_ok());
/// ```
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Subset {
    /// Data source of all links.
    pub data: Plugin<dyn DataSource>,
    /// File with the indices of the links, counted from 0, one per line, ascending; relative to the pipeline file.
    #[schemars(extend("format" = "path"))]
    pub links: PathBuf,
}

impl Default for Subset {
    fn default() -> Self {
        let whole: Box<dyn DataSource> = Box::new(Nerf2Spectrum::default());
        Self { data: whole.into(), links: LINKS.into() }
    }
}

#[typetag::serde]
impl DataSource for Subset {
    fn task(&self) -> Option<Task> {
        self.data.task()
    }

    /// Loads all links of the source, then selects some. Reads the indices first, so that their errors come early.
    fn load(&self, base: &Path, progress: Progress<'_>) -> Result<Dataset> {
        let path = base.join(&self.links);
        let links = read_ascending(&path, "index of a link, counted from 0,")?;
        let data = self.data.load(base, progress)?;
        if links.is_empty() || links.iter().any(|link| *link as usize >= data.len()) {
            let problem = format!("expected indices of links below {}, at least one", data.len());
            return Err(Error::input(&path, problem));
        }
        data.subset(&links.into_iter().map(|link| link as usize).collect::<Vec<_>>())
    }

    fn check(&self) -> Result<(), String> {
        if self.links.as_os_str().is_empty() {
            return Err("`links` is empty; name the file of the links".into());
        }
        Ok(())
    }
}

/// Writes the new folder `out` with the indices `links` for [`Subset`], in the file [`LINKS`].
///
/// # Errors
/// `out` is not empty, or a write failed.
pub fn write_links(out: &Path, links: &[usize]) -> Result<()> {
    let folder = NewFolder::begin(out)?;
    write(&folder.path().join(LINKS), format_lines(links.iter().copied()))?;
    folder.publish()
}
