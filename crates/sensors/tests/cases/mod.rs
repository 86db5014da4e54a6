//! What the recordings of users are like: each kind as a small recording that is made here.

mod making;
mod stamps;
mod stereo;
mod topics;
