//! Networks run by ONNX Runtime, whose shared library is searched when the first network is loaded.

use super::error::NetworkError;
use crate::features::tensor::Tensor;
use crate::features::weights;
use ort::environment::Environment;
use std::path::PathBuf;
use std::sync::OnceLock;

/// File name of the library.
const LIBRARY: &str = if cfg!(target_os = "macos") { "libonnxruntime.dylib" } else { "libonnxruntime.so" };
/// The environment variable with the path of the library, as other programs use it.
const LIBRARY_VARIABLE: &str = "ORT_DYLIB_PATH";

/// The library, loaded once per process; `None` if it is not found or too old.
pub(super) fn environment() -> Option<&'static Environment> {
    static ENVIRONMENT: OnceLock<Option<Environment>> = OnceLock::new();
    ENVIRONMENT.get_or_init(load_library).as_ref()
}

fn load_library() -> Option<Environment> {
    let named = std::env::var_os(LIBRARY_VARIABLE).map(PathBuf::from);
    let beside_weights = Some(weights::default_folder().join(LIBRARY)).filter(|path| path.exists());
    let candidates = [named, beside_weights, Some(PathBuf::from(LIBRARY))];
    candidates.into_iter().flatten().find_map(|path| {
        let environment = ort::init_from(path).ok()?.with_name("driftless").build().ok()?;
        // Errors are returned; no other log output.
        environment.set_log_level(ort::logging::LogLevel::Fatal);
        Some(environment)
    })
}

/// A loaded network.
pub(super) struct Session {
    session: ort::session::Session,
    input: String,
}

impl Session {
    pub fn load(onnx: &[u8], input: &str, outputs: &[&str]) -> Result<Self, NetworkError> {
        let environment = environment().ok_or(NetworkError::NoEngine)?;
        let session = one_thread(environment, onnx).map_err(|error| NetworkError::Load(error.into()))?;
        for name in outputs {
            if !session.outputs().iter().any(|outlet| outlet.name() == *name) {
                return Err(NetworkError::Tensor((*name).to_owned()));
            }
        }
        if !session.inputs().iter().any(|outlet| outlet.name() == input) {
            return Err(NetworkError::Tensor(input.to_owned()));
        }
        Ok(Self { session, input: input.to_owned() })
    }

    pub fn run(
        &mut self,
        shape: [usize; 4],
        numbers: Vec<f32>,
        outputs: &[String],
    ) -> Result<Vec<Tensor>, NetworkError> {
        let failed = |error: ort::Error| NetworkError::Run(error.into());
        let image = ort::value::Tensor::from_array((shape, numbers)).map_err(failed)?;
        let found = self.session.run(ort::inputs![self.input.as_str() => image]).map_err(failed)?;
        outputs
            .iter()
            .map(|name| {
                let value = found.get(name).ok_or_else(|| NetworkError::Tensor(name.clone()))?;
                let (shape, data) = value.try_extract_tensor::<f32>().map_err(failed)?;
                let shape = shape.iter().map(|&size| usize::try_from(size).unwrap_or(0)).collect();
                Ok(Tensor { shape, data: data.to_vec() })
            })
            .collect()
    }
}

fn one_thread(environment: &Environment, onnx: &[u8]) -> ort::Result<ort::session::Session> {
    let builder = ort::session::Session::builder(environment)?;
    builder.with_intra_threads(1)?.with_inter_threads(1)?.commit_from_memory(onnx)
}
