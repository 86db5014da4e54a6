//! Weights of networks.

use vision::features::neural::state_dict::StateDict;

/// XFeat's weights, as safetensors.
pub fn weights(data: &[u8]) {
    let _ = StateDict::read(data);
}
