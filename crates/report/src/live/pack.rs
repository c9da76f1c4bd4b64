//! `Pack`: arrays and a note on their way to a page, as one safetensors file; `web/tensors.js` reads it, as it reads models.

use pwrfgs_core::Real;
use safetensors::tensor::{Dtype, TensorView};
use serde_json::Value;
use std::collections::{BTreeMap, HashMap};

/// Named arrays and what is to be said of them.
#[derive(Clone, Debug, Default)]
pub struct Pack {
    /// Whatever is no array.
    pub note: Value,
    arrays: BTreeMap<String, (Dtype, Vec<usize>, Vec<u8>)>,
}

impl Pack {
    /// No arrays yet.
    pub fn new(note: Value) -> Self {
        Self { note, arrays: BTreeMap::new() }
    }

    /// Adds numbers, in single precision; they fill `shape` row by row.
    pub fn put(&mut self, name: &str, shape: &[usize], values: impl IntoIterator<Item = Real>) {
        let bytes: Vec<u8> = values.into_iter().flat_map(|v| (v as f32).to_le_bytes()).collect();
        self.insert(name, Dtype::F32, shape, bytes);
    }

    /// Adds bytes; they fill `shape` row by row.
    pub fn put_bytes(&mut self, name: &str, shape: &[usize], bytes: Vec<u8>) {
        self.insert(name, Dtype::U8, shape, bytes);
    }

    fn insert(&mut self, name: &str, dtype: Dtype, shape: &[usize], bytes: Vec<u8>) {
        let size = if dtype == Dtype::F32 { 4 } else { 1 };
        assert_eq!(shape.iter().product::<usize>() * size, bytes.len(), "an array fills its shape");
        self.arrays.insert(name.into(), (dtype, shape.to_vec(), bytes));
    }

    /// The file.
    pub fn to_bytes(&self) -> Vec<u8> {
        let views = self.arrays.iter().map(|(name, (dtype, shape, bytes))| {
            (name.as_str(), TensorView::new(*dtype, shape.clone(), bytes).expect("an array fills its shape"))
        });
        let note = HashMap::from([("pwrfgs".to_owned(), self.note.to_string())]);
        safetensors::serialize(views, Some(note)).expect("shapes fit their data")
    }
}
