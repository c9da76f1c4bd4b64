//! Named tensors and metadata in one safetensors file: the format of models and checkpoints.

use pwrfgs_core::{Real, files::digest};
use safetensors::tensor::{Dtype, SafeTensors, TensorView};
use serde::Serialize;
use std::collections::{BTreeMap, HashMap};

/// The only metadata key: a second one would make the order of bytes depend on a hash.
const NOTE: &str = "pwrfgs";

/// End of the name of the scales of an 8-bit tensor.
pub(crate) const SCALES: &str = ".scales";

/// Tensors by name, with shapes, and a JSON note.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Tensors {
    /// JSON text of the metadata.
    pub note: String,
    tensors: BTreeMap<String, (Vec<usize>, Values)>,
}

/// Values of a tensor, row by row.
#[derive(Clone, Debug, PartialEq)]
enum Values {
    Reals(Vec<Real>),
    /// 8-bit integers, not converted to [`Real`], since their tensors are large.
    Bytes(Vec<i8>),
    /// Identifiers, of which [`Real`] would round those above 2^24.
    Ids(Vec<u32>),
}

impl Values {
    /// Returns the number of values.
    fn len(&self) -> usize {
        match self {
            Self::Reals(values) => values.len(),
            Self::Bytes(values) => values.len(),
            Self::Ids(values) => values.len(),
        }
    }

    /// Returns type and bytes in the file.
    fn encoded(&self) -> (Dtype, Vec<u8>) {
        let real = if size_of::<Real>() == 8 { Dtype::F64 } else { Dtype::F32 };
        match self {
            Self::Reals(values) => (real, values.iter().flat_map(|v| v.to_le_bytes()).collect()),
            Self::Bytes(values) => (Dtype::I8, values.iter().flat_map(|v| v.to_le_bytes()).collect()),
            Self::Ids(values) => (Dtype::U32, values.iter().flat_map(|v| v.to_le_bytes()).collect()),
        }
    }

    /// Decodes the bytes of a file; `None` for a type that no file of pwrfgs has.
    fn decode(dtype: Dtype, bytes: &[u8]) -> Option<Self> {
        Some(match dtype {
            Dtype::I8 => Self::Bytes(bytes.iter().map(|b| i8::from_le_bytes([*b])).collect()),
            Dtype::U32 => Self::Ids(bytes.as_chunks().0.iter().map(|b| u32::from_le_bytes(*b)).collect()),
            Dtype::F32 => Self::Reals(bytes.as_chunks().0.iter().map(|b| f32::from_le_bytes(*b) as Real).collect()),
            Dtype::F64 => Self::Reals(bytes.as_chunks().0.iter().map(|b| f64::from_le_bytes(*b) as Real).collect()),
            Dtype::F16 => {
                let wide = |b: &[u8; 2]| half::f16::from_le_bytes(*b).to_f64() as Real;
                Self::Reals(bytes.as_chunks().0.iter().map(wide).collect())
            }
            _ => return None,
        })
    }
}

impl Tensors {
    /// Creates an empty file; `note` is plain data.
    pub fn new(note: &impl Serialize) -> Self {
        Self { note: serde_json::to_string(note).expect("plain data"), ..Self::default() }
    }

    /// Adds a tensor; `values` must fill `shape`, row by row.
    pub fn put(&mut self, name: impl Into<String>, shape: Vec<usize>, values: Vec<Real>) {
        self.insert(name, shape, Values::Reals(values));
    }

    /// Adds a tensor of 8-bit integers; `values` must fill `shape`, row by row.
    pub fn put_i8(&mut self, name: impl Into<String>, shape: Vec<usize>, values: Vec<i8>) {
        self.insert(name, shape, Values::Bytes(values));
    }

    /// Adds a tensor of identifiers.
    pub fn put_ids(&mut self, name: impl Into<String>, ids: &[u32]) {
        self.insert(name, vec![ids.len()], Values::Ids(ids.to_vec()));
    }

    /// Adds a tensor, or replaces that of the same name.
    fn insert(&mut self, name: impl Into<String>, shape: Vec<usize>, values: Values) {
        assert_eq!(shape.iter().product::<usize>(), values.len(), "a tensor fills its shape");
        self.tensors.insert(name.into(), (shape, values));
    }

    /// Rounds a tensor `[rows, columns]` to 8 bits, and adds a tensor `NAME.scales` `[rows]` with a factor per row. Readers
    /// restore the values.
    pub(crate) fn round_to_bytes(&mut self, name: &str) {
        let shape = self.shape(name).expect("a tensor of the file").to_vec();
        let values = self.take(name, &shape).expect("finite values");
        let (integers, scales) = quantise(&values, shape[1]);
        self.put(format!("{name}{SCALES}"), vec![shape[0]], scales);
        self.put_i8(name, shape, integers);
    }

    /// Takes out a tensor of 8-bit integers of this shape.
    ///
    /// # Errors
    /// The tensor is missing or has another shape or type; the message names it.
    pub fn take_i8(&mut self, name: &str, shape: &[usize]) -> Result<Vec<i8>, String> {
        match self.take_values(name, shape)? {
            Values::Bytes(values) => Ok(values),
            _ => Err(format!("tensor `{name}` is not of type I8")),
        }
    }

    /// Takes out a tensor of `n` identifiers.
    ///
    /// # Errors
    /// The tensor is missing or has another shape or type; the message names it.
    pub fn take_ids(&mut self, name: &str, n: usize) -> Result<Vec<u32>, String> {
        match self.take_values(name, &[n])? {
            Values::Ids(ids) => Ok(ids),
            _ => Err(format!("tensor `{name}` is not of type U32")),
        }
    }

    /// Takes out a tensor of this shape.
    ///
    /// # Errors
    /// The tensor is missing, has another shape or type, or holds a number that is not finite; the message names it.
    pub fn take(&mut self, name: &str, shape: &[usize]) -> Result<Vec<Real>, String> {
        let Values::Reals(values) = self.take_values(name, shape)? else {
            return Err(format!("tensor `{name}` is not of type F16, F32 or F64"));
        };
        if let Some(at) = values.iter().position(|v| !v.is_finite()) {
            return Err(format!("tensor `{name}` holds {} at {at}", values[at]));
        }
        Ok(values)
    }

    /// Takes out a tensor of this shape and any type. Returns the errors of [`Self::check_shape`].
    fn take_values(&mut self, name: &str, shape: &[usize]) -> Result<Values, String> {
        self.check_shape(name, shape)?;
        Ok(self.tensors.remove(name).expect("it is there").1)
    }

    /// Checks for a tensor of this shape.
    ///
    /// # Errors
    /// The tensor is missing or has another shape; the message names it.
    pub fn check_shape(&self, name: &str, shape: &[usize]) -> Result<(), String> {
        match self.shape(name) {
            None => Err(format!("tensor `{name}` is missing")),
            Some(actual) if actual == shape => Ok(()),
            Some(actual) => Err(format!("tensor `{name}` has shape {actual:?}, expected {shape:?}")),
        }
    }

    /// Returns the shape of a tensor; `None` if there is no tensor of this name.
    pub fn shape(&self, name: &str) -> Option<&[usize]> {
        self.tensors.get(name).map(|(shape, _)| shape.as_slice())
    }

    /// Returns the SHA-256 of the note and of every tensor with its name and shape.
    pub fn digest(&self) -> String {
        let mut content = self.note.clone().into_bytes();
        for (name, (shape, values)) in &self.tensors {
            content.extend(format!("\n{name} {shape:?}\n").bytes());
            content.extend(values.encoded().1);
        }
        digest(&content)
    }

    /// Returns the bytes of the file; equal tensors give equal bytes.
    pub fn to_bytes(&self) -> Vec<u8> {
        self.encode(|_| false)
    }

    /// Returns the bytes of the file, with 16-bit floating-point numbers (F16) for tensors for whose name `is_half`
    /// holds.
    ///
    /// # Errors
    /// A number is beyond ±65504, the largest of F16; the message names its tensor.
    pub fn to_bytes_half(&self, is_half: impl Fn(&str) -> bool) -> Result<Vec<u8>, String> {
        let too_large = |v: &Real| !half::f16::from_f64(f64::from(*v)).is_finite();
        let fault = |(name, (_, values)): &(&String, &(_, Values))| match values {
            Values::Reals(values) => is_half(name) && values.iter().any(too_large),
            _ => false,
        };
        match self.tensors.iter().find(fault) {
            Some((name, _)) => Err(format!("tensor `{name}` has a value too large for 16 bits")),
            None => Ok(self.encode(is_half)),
        }
    }

    /// Returns the bytes of the file, with F16 for tensors for whose name `is_half` holds.
    fn encode(&self, is_half: impl Fn(&str) -> bool) -> Vec<u8> {
        let encoded = |(name, (shape, values)): (&String, &(Vec<usize>, Values))| {
            let narrow = |v: &Real| half::f16::from_f64(f64::from(*v)).to_le_bytes();
            let (dtype, bytes) = match values {
                Values::Reals(values) if is_half(name) => (Dtype::F16, values.iter().flat_map(narrow).collect()),
                values => values.encoded(),
            };
            (name.clone(), shape.clone(), dtype, bytes)
        };
        let encoded: Vec<_> = self.tensors.iter().map(encoded).collect();
        let views = encoded.iter().map(|(name, shape, dtype, bytes)| {
            (name.as_str(), TensorView::new(*dtype, shape.clone(), bytes).expect("a tensor fills its shape"))
        });
        let note = HashMap::from([(NOTE.to_owned(), self.note.clone())]);
        safetensors::serialize(views, Some(note)).expect("shapes fit their data")
    }

    /// Reads the bytes of a file.
    ///
    /// # Errors
    /// The bytes are damaged, are no safetensors file of pwrfgs, or hold a tensor of an unsupported type or
    /// with scales that do not fit.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, String> {
        let damaged = |e: safetensors::SafeTensorError| format!("damaged or not a safetensors file ({e})");
        let (_, header) = SafeTensors::read_metadata(bytes).map_err(damaged)?;
        let note = header.metadata().as_ref().and_then(|m| m.get(NOTE)).cloned();
        let note = note.ok_or("a safetensors file, but not one of pwrfgs")?;
        let file = SafeTensors::deserialize(bytes).map_err(damaged)?;
        let mut read = Self { note, tensors: BTreeMap::new() };
        for (name, view) in file.tensors() {
            let Some(values) = Values::decode(view.dtype(), view.data()) else {
                let dtype = view.dtype();
                return Err(format!("tensor `{name}` has type {dtype:?}, expected I8, U32, F16, F32 or F64"));
            };
            read.tensors.insert(name, (view.shape().to_vec(), values));
        }
        read.restore_rounded()?;
        Ok(read)
    }

    /// Replaces 8-bit tensors that have scales by their values. Returns an error for scales of another shape or type,
    /// or a scale that is not finite.
    fn restore_rounded(&mut self) -> Result<(), String> {
        let is_scaled = |name: &String| self.tensors.contains_key(&format!("{name}{SCALES}"));
        let short =
            self.tensors.iter().filter(|(name, (_, values))| matches!(values, Values::Bytes(_)) && is_scaled(name));
        for (name, shape) in short.map(|(name, (shape, _))| (name.clone(), shape.clone())).collect::<Vec<_>>() {
            let integers = self.take_i8(&name, &shape)?;
            let rows = shape.first().copied().unwrap_or(1);
            let scales = self.take(&format!("{name}{SCALES}"), &[rows])?;
            let columns = (integers.len() / rows.max(1)).max(1);
            let values = integers.iter().enumerate().map(|(i, q)| scales[i / columns] * Real::from(*q)).collect();
            self.insert(name, shape, Values::Reals(values));
        }
        Ok(())
    }
}

/// Returns `values` `[rows, columns]` as integers from −127 to 127, and a scale per row; products of both are the values
/// to half a scale. A row of zeros has scale 0.
pub(crate) fn quantise(values: &[Real], columns: usize) -> (Vec<i8>, Vec<Real>) {
    let largest = |row: &[Real]| row.iter().fold(0.0, |most: Real, v| most.max(v.abs()));
    let scales: Vec<Real> = values.chunks_exact(columns.max(1)).map(|row| largest(row) / 127.0).collect();
    let integers = |(row, scale): (&[Real], &Real)| -> Vec<i8> {
        let scale = if *scale > 0.0 { *scale } else { 1.0 };
        row.iter().map(|v| (v / scale).round().clamp(-127.0, 127.0) as i8).collect()
    };
    (values.chunks_exact(columns.max(1)).zip(&scales).flat_map(integers).collect(), scales)
}
