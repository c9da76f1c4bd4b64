//! One folder of reference renders: `.npy` arrays and a manifest.

use pwrfgs::core::Real;
use pwrfgs::core::testing::shared;
use std::fs::File;
use std::io::BufReader;
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

    fn file(&self, what: &str) -> npyz::NpyFile<BufReader<File>> {
        let path = self.folder.join(format!("{what}.npy"));
        npyz::NpyFile::new(BufReader::new(File::open(path).unwrap())).unwrap()
    }

    /// An array of numbers, flat.
    pub(crate) fn array(&self, what: &str) -> Vec<Real> {
        self.file(what).into_vec::<f64>().unwrap().into_iter().map(|v| v as Real).collect()
    }

    /// An array of integers, flat, as numbers.
    pub(crate) fn integers(&self, what: &str) -> Vec<Real> {
        self.file(what).into_vec::<i64>().unwrap().into_iter().map(|v| v as Real).collect()
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
