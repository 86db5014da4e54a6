//! Writes safetensors files.

use crate::reference::Tensors;
use safetensors::Dtype;
use safetensors::tensor::TensorView;

/// The file of named tensors.
pub fn write(tensors: &Tensors) -> Vec<u8> {
    let bytes = |data: &[f32]| data.iter().flat_map(|number| number.to_le_bytes()).collect::<Vec<u8>>();
    let data: Vec<Vec<u8>> = tensors.values().map(|(_, data)| bytes(data)).collect();
    let views = tensors.iter().zip(&data).map(|((name, (shape, _)), data)| {
        (name.as_str(), TensorView::new(Dtype::F32, shape.clone(), data).unwrap())
    });
    safetensors::serialize(views, None).unwrap()
}

/// A file from its header (JSON) and its data.
pub fn assemble(header: &str, data: &[u8]) -> Vec<u8> {
    [&(header.len() as u64).to_le_bytes(), header.as_bytes(), data].concat()
}
