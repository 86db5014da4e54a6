//! A map that several servers serve by cells answers as one that one server has, and survives what happens to them.

mod answers;
mod choice;
mod cold;
mod kills;
mod names;
pub mod page;
mod servers;
mod store_faults;
mod town;
