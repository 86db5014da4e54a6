//! Load on one server, measured: no checks, so they run only when asked for.
//!
//! ```sh
//! cargo test --release -p driftless-map-server --test main -- --ignored --nocapture latencies_of_a_fleet
//! cargo test --release -p driftless-map-server --test main -- --ignored --nocapture hostile_load
//! cargo test --release -p driftless-map-server --test main -- --ignored --nocapture a_query_in_cells
//! cargo test --release -p driftless-map-server --test main -- --ignored --nocapture a_town_at_four
//! cargo test --release -p driftless-map-server --test main -- --ignored --nocapture first_picture_of_a_city
//! cargo test --release -p driftless-map-server --test main -- --ignored --nocapture viewers_beside_robots
//! cargo test --release -p driftless-map-server --test main -- --ignored --nocapture what_a_report_costs
//! ```

mod cells;
mod cold;
mod fleet;
mod hostile;
mod images;
mod lossy;
mod town;
mod viewers;
