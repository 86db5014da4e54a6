//! Tensors by name, from the files that `torch.save` writes: a zip archive of a pickle, which says where each tensor
//! lies, and the numbers of each storage in a file of their own. Python and torch are not needed.
//!
//! Only what a file of weights holds is understood: contiguous `f32` tensors of little-endian numbers. Integer
//! tensors (counters of batches) are left out. Every size is checked against the bytes that are there before
//! anything is allocated for it.

use super::pickle::{self, PickleError, Value};
use std::collections::BTreeMap;
use std::io::{Cursor, Read as _};
use zip::ZipArchive;

/// Larger files are refused; XFeat's weights have 6 MB.
const MAX_BYTES: u64 = 64 << 20;

/// Numbers in row-major order.
#[derive(Clone, Debug, PartialEq)]
pub struct Tensor {
    /// Numbers along each axis, the last axis fastest.
    pub shape: Vec<usize>,
    /// The numbers.
    pub data: Vec<f32>,
}

/// Tensors by name.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StateDict {
    tensors: BTreeMap<String, Tensor>,
}

/// Why bytes are no table of tensors.
#[derive(Debug, thiserror::Error)]
pub enum StateDictError {
    /// The archive is damaged, or is none.
    #[error("the zip archive is damaged: {0}")]
    Zip(#[from] zip::result::ZipError),
    /// A part of the archive is damaged.
    #[error("{name} in the archive is damaged: {source}")]
    Entry {
        /// Which part.
        name: String,
        /// What happened.
        source: std::io::Error,
    },
    /// The archive is larger than any weights are, or unpacks to more.
    #[error("the archive unpacks to more than {MAX_BYTES} bytes")]
    TooLarge,
    /// The archive has no table of tensors.
    #[error("the archive has no data.pkl: it was not written by torch.save")]
    NoTable,
    /// The table of tensors is damaged.
    #[error("the table of tensors is damaged: {0}")]
    Table(String),
    /// A tensor is not described as torch does.
    #[error("tensor {name}: {reason}")]
    Tensor {
        /// Which tensor.
        name: String,
        /// What is wrong.
        reason: &'static str,
    },
    /// A tensor that the network needs is missing.
    #[error("tensor {0} is missing")]
    Missing(String),
    /// A tensor has the wrong shape.
    #[error("tensor {name} has the shape {found:?}; the network needs {needed:?}")]
    Shape {
        /// Which tensor.
        name: String,
        /// Its shape.
        found: Vec<usize>,
        /// The shape the network needs.
        needed: Vec<usize>,
    },
    /// A tensor holds NaN or infinity.
    #[error("tensor {0} holds numbers that are not finite")]
    NotFinite(String),
}

impl From<PickleError> for StateDictError {
    fn from(error: PickleError) -> Self {
        Self::Table(error.to_string())
    }
}

impl StateDict {
    /// Reads the bytes of a file that `torch.save(module.state_dict(), file)` wrote.
    ///
    /// # Errors
    /// [`StateDictError`], whatever the bytes are.
    pub fn read(bytes: &[u8]) -> Result<Self, StateDictError> {
        if bytes.len() as u64 > MAX_BYTES {
            return Err(StateDictError::TooLarge);
        }
        let mut archive = Archive { zip: ZipArchive::new(Cursor::new(bytes))?, left: MAX_BYTES };
        let table_name = archive
            .zip
            .file_names()
            .filter_map(Result::ok)
            .find(|name| name.ends_with("/data.pkl"))
            .map(std::borrow::Cow::into_owned);
        let table_name = table_name.ok_or(StateDictError::NoTable)?;
        let root = table_name.trim_end_matches("data.pkl").to_owned();
        let table = pickle::load(&archive.read(&table_name)?)?;
        let Value::Dict(items) = &*table else {
            return Err(StateDictError::Table("it holds one value, not a table of tensors".into()));
        };
        let mut tensors = BTreeMap::new();
        for (key, value) in items {
            let Value::Text(name) = &**key else {
                return Err(StateDictError::Table("a tensor has no name".into()));
            };
            let wrong = |reason| StateDictError::Tensor { name: name.clone(), reason };
            let Some(place) = Place::of(value).map_err(wrong)? else { continue };
            let storage = archive.read(&format!("{root}data/{}", place.storage))?;
            let data = place.numbers(&storage).map_err(wrong)?;
            tensors.insert(name.clone(), Tensor { shape: place.shape, data });
        }
        Ok(Self { tensors })
    }

    /// Adds a tensor, or replaces it.
    pub fn insert(&mut self, name: &str, tensor: Tensor) {
        self.tensors.insert(name.to_owned(), tensor);
    }

    /// The numbers of a tensor of a given shape.
    ///
    /// # Errors
    /// [`StateDictError::Missing`], [`StateDictError::Shape`], [`StateDictError::NotFinite`].
    pub fn get(&self, name: &str, shape: &[usize]) -> Result<&[f32], StateDictError> {
        let tensor = self.tensors.get(name).ok_or_else(|| StateDictError::Missing(name.to_owned()))?;
        if tensor.shape != shape || tensor.data.len() != shape.iter().product::<usize>() {
            let (found, needed) = (tensor.shape.clone(), shape.to_vec());
            return Err(StateDictError::Shape { name: name.to_owned(), found, needed });
        }
        if !tensor.data.iter().all(|number| number.is_finite()) {
            return Err(StateDictError::NotFinite(name.to_owned()));
        }
        Ok(&tensor.data)
    }
}

/// The archive, and how much may still be unpacked from it.
struct Archive<'a> {
    zip: ZipArchive<Cursor<&'a [u8]>>,
    left: u64,
}

impl Archive<'_> {
    fn read(&mut self, name: &str) -> Result<Vec<u8>, StateDictError> {
        let entry = self.zip.by_name(name)?;
        let mut bytes = Vec::new();
        let damaged = |source| StateDictError::Entry { name: name.to_owned(), source };
        // What the archive says of the size is not believed.
        entry.take(self.left + 1).read_to_end(&mut bytes).map_err(damaged)?;
        self.left = self.left.checked_sub(bytes.len() as u64).ok_or(StateDictError::TooLarge)?;
        Ok(bytes)
    }
}

/// Where the numbers of a tensor are.
struct Place {
    storage: String,
    /// First number.
    offset: usize,
    shape: Vec<usize>,
}

impl Place {
    /// Reads `_rebuild_tensor_v2((storage, type, key, device, count), offset, shape, strides, ...)`; `None` for tensors
    /// that are not of `f32`.
    fn of(value: &Value) -> Result<Option<Self>, &'static str> {
        const UNKNOWN: &str = "it is not described as torch describes tensors";
        let Value::Call(function, arguments) = value else { return Err(UNKNOWN) };
        let (Value::Name(module, name), Value::Tuple(arguments)) = (&**function, &**arguments) else {
            return Err(UNKNOWN);
        };
        if module != "torch._utils" || name != "_rebuild_tensor_v2" {
            return Err(UNKNOWN);
        }
        let [storage, offset, shape, strides, ..] = arguments.as_slice() else { return Err(UNKNOWN) };
        let (Value::Persistent(id), Value::Int(offset)) = (&**storage, &**offset) else {
            return Err(UNKNOWN);
        };
        let Value::Tuple(id) = &**id else { return Err(UNKNOWN) };
        let [_, kind, key, ..] = id.as_slice() else { return Err(UNKNOWN) };
        let (Value::Name(_, kind), Value::Text(key)) = (&**kind, &**key) else { return Err(UNKNOWN) };
        if kind == "LongStorage" {
            return Ok(None);
        }
        if kind != "FloatStorage" {
            return Err("its numbers are not of 32 bits");
        }
        let shape = sizes(shape).ok_or(UNKNOWN)?;
        if sizes(strides).ok_or(UNKNOWN)? != contiguous_strides(&shape).ok_or("it is too large")? {
            return Err("its numbers do not lie one after the other");
        }
        let offset = usize::try_from(*offset).map_err(|_| UNKNOWN)?;
        Ok(Some(Self { storage: key.clone(), offset, shape }))
    }

    /// The tensor's numbers out of those of its storage.
    fn numbers(&self, storage: &[u8]) -> Result<Vec<f32>, &'static str> {
        let count = self.shape.iter().try_fold(1_usize, |count, &size| count.checked_mul(size));
        let end = count.and_then(|count| self.offset.checked_add(count));
        let numbers = storage.as_chunks::<4>().0;
        let own = end.and_then(|end| numbers.get(self.offset..end));
        let own = own.ok_or("it has more numbers than its storage")?;
        Ok(own.iter().map(|&number| f32::from_le_bytes(number)).collect())
    }
}

fn sizes(value: &Value) -> Option<Vec<usize>> {
    let Value::Tuple(parts) = value else { return None };
    let size = |part: &std::rc::Rc<Value>| match **part {
        Value::Int(size) => usize::try_from(size).ok(),
        _ => None,
    };
    parts.iter().map(size).collect()
}

fn contiguous_strides(shape: &[usize]) -> Option<Vec<usize>> {
    let mut strides = vec![1; shape.len()];
    for axis in (1..shape.len()).rev() {
        strides[axis - 1] = shape[axis].checked_mul(strides[axis])?;
    }
    Some(strides)
}
