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
    long: BTreeMap<String, (Vec<usize>, Vec<Real>)>,
    /// 8-bit tensors, which are large: not converted to [`Real`].
    short: BTreeMap<String, (Vec<usize>, Vec<i8>)>,
}

impl Tensors {
    /// Creates an empty file; `note` is plain data.
    pub fn new(note: &impl Serialize) -> Self {
        Self { note: serde_json::to_string(note).expect("plain data"), ..Self::default() }
    }

    /// Adds a tensor; `values` fill `shape` row by row.
    pub fn put(&mut self, name: impl Into<String>, shape: Vec<usize>, values: Vec<Real>) {
        assert_eq!(shape.iter().product::<usize>(), values.len(), "a tensor fills its shape");
        self.long.insert(name.into(), (shape, values));
    }

    /// Adds a tensor of 8-bit integers; `values` fill `shape` row by row.
    pub fn put_short(&mut self, name: impl Into<String>, shape: Vec<usize>, values: Vec<i8>) {
        assert_eq!(shape.iter().product::<usize>(), values.len(), "a tensor fills its shape");
        self.short.insert(name.into(), (shape, values));
    }

    /// Rounds a tensor `[rows, columns]` to 8 bits, and adds a tensor `NAME.scales` `[rows]` with a factor per row. Readers
    /// restore the values.
    pub(crate) fn round_to_bytes(&mut self, name: &str) {
        let (shape, values) = self.long.remove(name).expect("a tensor of the file");
        let (integers, scales) = quantise(&values, shape[1]);
        self.put(format!("{name}{SCALES}"), vec![shape[0]], scales);
        self.put_short(name, shape, integers);
    }

    /// Takes out a tensor of 8-bit integers of this shape.
    ///
    /// # Errors
    /// The message names the tensor and the expected shape.
    pub fn take_short(&mut self, name: &str, shape: &[usize]) -> Result<Vec<i8>, String> {
        let (found, values) =
            self.short.remove(name).ok_or_else(|| format!("tensor `{name}` of type I8 is missing"))?;
        if found != shape {
            return Err(format!("tensor `{name}` has shape {found:?}, expected {shape:?}"));
        }
        Ok(values)
    }

    /// Takes out a tensor of this shape.
    ///
    /// # Errors
    /// The message names the tensor and the expected shape.
    pub fn take(&mut self, name: &str, shape: &[usize]) -> Result<Vec<Real>, String> {
        self.expect(name, shape)?;
        let (_, values) = self.long.remove(name).expect("it is there");
        if let Some(at) = values.iter().position(|v| !v.is_finite()) {
            return Err(format!("tensor `{name}` holds {} at {at}", values[at]));
        }
        Ok(values)
    }

    /// Checks for a tensor of this shape.
    ///
    /// # Errors
    /// The message names the tensor and the expected shape.
    pub fn expect(&self, name: &str, shape: &[usize]) -> Result<(), String> {
        match self.shape(name) {
            None => Err(format!("tensor `{name}` is missing")),
            Some(found) if found == shape => Ok(()),
            Some(found) => Err(format!("tensor `{name}` has shape {found:?}, expected {shape:?}")),
        }
    }

    /// Returns the shape of a tensor.
    pub fn shape(&self, name: &str) -> Option<&[usize]> {
        self.long.get(name).map(|(shape, _)| shape.as_slice())
    }

    /// Returns the SHA-256 of the note and of every tensor with its name and shape.
    pub fn digest(&self) -> String {
        let mut all = self.note.clone().into_bytes();
        for (name, (shape, values)) in &self.long {
            all.extend(format!("\n{name} {shape:?}\n").bytes());
            all.extend(values.iter().flat_map(|v| v.to_le_bytes()));
        }
        for (name, (shape, values)) in &self.short {
            all.extend(format!("\n{name} {shape:?}\n").bytes());
            all.extend(values.iter().flat_map(|v| v.to_le_bytes()));
        }
        digest(&all)
    }

    /// Returns the bytes of the file; equal tensors give equal bytes.
    pub fn to_bytes(&self) -> Vec<u8> {
        self.encode(|_| false)
    }

    /// Returns the bytes of the file, with 16-bit floating-point numbers (F16) for tensors whose name is `short`.
    ///
    /// # Errors
    /// The message names a tensor with a number beyond ±65504, the largest of F16.
    pub fn to_bytes_half(&self, short: impl Fn(&str) -> bool) -> Result<Vec<u8>, String> {
        let too_large = |v: &Real| !half::f16::from_f64(f64::from(*v)).is_finite();
        match self.long.iter().find(|(name, (_, values))| short(name) && values.iter().any(too_large)) {
            Some((name, _)) => Err(format!("tensor `{name}` has a value too large for 16 bits")),
            None => Ok(self.encode(short)),
        }
    }

    fn encode(&self, half: impl Fn(&str) -> bool) -> Vec<u8> {
        let whole = if size_of::<Real>() == 8 { Dtype::F64 } else { Dtype::F32 };
        let encoded = |name: &str, values: &[Real]| -> (Dtype, Vec<u8>) {
            if half(name) {
                let short = |v: &Real| half::f16::from_f64(f64::from(*v)).to_le_bytes();
                (Dtype::F16, values.iter().flat_map(short).collect())
            } else {
                (whole, values.iter().flat_map(|v| v.to_le_bytes()).collect())
            }
        };
        let reals = self.long.iter().map(|(name, (shape, values))| (name, shape, encoded(name, values)));
        let bytes = |values: &[i8]| values.iter().flat_map(|v| v.to_le_bytes()).collect();
        let bytes_of = self.short.iter().map(|(name, (shape, values))| (name, shape, (Dtype::I8, bytes(values))));
        let all: Vec<_> = reals.chain(bytes_of).collect();
        let views = all.iter().map(|(name, shape, (dtype, data))| {
            (name.as_str(), TensorView::new(*dtype, (*shape).clone(), data).expect("a tensor fills its shape"))
        });
        let note = HashMap::from([(NOTE.to_owned(), self.note.clone())]);
        safetensors::serialize(views, Some(note)).expect("shapes fit their data")
    }

    /// Reads the bytes of a file.
    ///
    /// # Errors
    /// The message describes the damage.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, String> {
        let damaged = |e: safetensors::SafeTensorError| format!("damaged or not a safetensors file ({e})");
        let (_, header) = SafeTensors::read_metadata(bytes).map_err(damaged)?;
        let note = header.metadata().as_ref().and_then(|m| m.get(NOTE)).cloned();
        let note = note.ok_or("a safetensors file, but not one of pwrfgs")?;
        let file = SafeTensors::deserialize(bytes).map_err(damaged)?;
        let (mut long, mut short) = (BTreeMap::new(), BTreeMap::new());
        for (name, view) in file.tensors() {
            let data = view.data();
            if view.dtype() == Dtype::I8 {
                let values = data.iter().map(|b| i8::from_le_bytes([*b])).collect();
                short.insert(name, (view.shape().to_vec(), values));
                continue;
            }
            let values = match view.dtype() {
                Dtype::F32 => {
                    data.chunks_exact(4).map(|b| f32::from_le_bytes(b.try_into().expect("four")) as Real).collect()
                }
                Dtype::F64 => {
                    data.chunks_exact(8).map(|b| f64::from_le_bytes(b.try_into().expect("eight")) as Real).collect()
                }
                Dtype::F16 => {
                    let long = |b: &[u8]| half::f16::from_le_bytes(b.try_into().expect("two")).to_f64() as Real;
                    data.chunks_exact(2).map(long).collect()
                }
                other => {
                    return Err(format!("tensor `{name}` has type {other:?}, expected I8, F16, F32 or F64"));
                }
            };
            long.insert(name, (view.shape().to_vec(), values));
        }
        let mut read = Self { note, long, short };
        read.restore()?;
        Ok(read)
    }

    /// Replaces 8-bit tensors that have scales by their values.
    fn restore(&mut self) -> Result<(), String> {
        let scaled = |name: &&String| self.long.contains_key(&format!("{name}{SCALES}"));
        let names: Vec<String> = self.short.keys().filter(scaled).cloned().collect();
        for name in names {
            let (shape, integers) = self.short.remove(&name).expect("a key of the map");
            let rows = shape.first().copied().unwrap_or(1);
            let scales = self.take(&format!("{name}{SCALES}"), &[rows])?;
            let columns = integers.len() / rows.max(1);
            let values =
                integers.iter().enumerate().map(|(i, q)| scales[i / columns.max(1)] * Real::from(*q)).collect();
            self.long.insert(name, (shape, values));
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
