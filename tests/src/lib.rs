//! End to end tests over real Zenoh sessions and real databases.
