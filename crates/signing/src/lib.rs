//! Keys and signatures in the format of [minisign](https://jedisct1.github.io/minisign/).
//!
//! [`PublicKey`] verifies; with the feature `secret`, [`SecretKey`] signs.
#![cfg_attr(test, allow(clippy::unwrap_used))]

mod public_key;
#[cfg(feature = "secret")]
mod secret_key;

pub use public_key::{PublicKey, PublicKeyError, SignatureError};
#[cfg(feature = "secret")]
pub use secret_key::{KeyError, SecretKey, SignError};
