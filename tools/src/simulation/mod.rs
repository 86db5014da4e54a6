//! Simulates a place and two runs through it.
