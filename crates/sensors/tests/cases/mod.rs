//! What the recordings of users are like: each kind as a small recording that is made here.

mod carried;
mod foxglove;
mod gnss;
mod images;
mod making;
mod stamps;
mod stereo;
mod topics;
mod wheels;
