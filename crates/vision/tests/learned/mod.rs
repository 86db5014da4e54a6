//! Laws of the layers of networks, and of the files of their weights.

mod edgepoint;
mod layers;
mod state_dict;
