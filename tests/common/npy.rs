//! One folder of reference renders: `.npy` arrays and a manifest.

use pwrfgs::core::Real;
use pwrfgs::core::testing::{npy, shared};
use std::path::PathBuf;

/// A reference render.
pub(crate) struct Reference {
    pub(crate) name: String,
    folder: PathBuf,
}

impl Reference {
    /// The one called `name`, or `None` where the shared data are not at hand.
    pub(crate) fn open(name: &str) -> Option<Self> {
        Some(Self { name: name.into(), folder: shared(&format!("oracle/{name}"))? })
    }

    /// An array of numbers, flat.
    pub(crate) fn array(&self, what: &str) -> Vec<Real> {
        let bytes = std::fs::read(self.folder.join(format!("{what}.npy"))).unwrap();
        npy(&bytes).1.into_iter().map(|v| v as Real).collect()
    }

    /// An array that not every reference has.
    pub(crate) fn optional(&self, what: &str) -> Option<Vec<Real>> {
        self.folder.join(format!("{what}.npy")).exists().then(|| self.array(what))
    }

    /// An array as rows of K.
    pub(crate) fn rows<const K: usize>(&self, what: &str) -> Vec<[Real; K]> {
        self.array(what).as_chunks().0.to_vec()
    }

    /// A number of the manifest.
    pub(crate) fn number(&self, what: &str) -> Real {
        let text = std::fs::read_to_string(self.folder.join("manifest.json")).unwrap();
        let manifest: serde_json::Value = serde_json::from_str(&text).unwrap();
        manifest[what].as_f64().unwrap() as Real
    }
}
