//! Weights of networks.

use vision::features::StateDict;

/// XFeat's weights, as safetensors.
pub fn weights(data: &[u8]) {
    let _ = StateDict::read(data);
}
