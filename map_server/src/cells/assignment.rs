//! Which cells a server is to have: rendezvous hashing (Thaler & Ravishankar 1998).
//!
//! Every server computes the same from the names of all. A server that comes or goes moves only its own share.

use std::collections::BTreeSet;

use releases::CellId;
use sha2::{Digest as _, Sha256};

/// The cells of one server.
///
/// # Arguments
/// * `servers`: the names of all.
/// * `replicas`: at so many servers each cell is to be.
pub(crate) fn cells_of(
    server: &str,
    cells: impl Iterator<Item = CellId>,
    servers: &BTreeSet<String>,
    replicas: usize,
) -> BTreeSet<CellId> {
    let is_mine = |cell: &CellId| {
        let own = weight(*cell, server);
        // Of equal weights the first name: two servers never take each other for the better one.
        let better = servers.iter().filter(|other| {
            other.as_str() != server && (weight(*cell, other), server) > (own, other.as_str())
        });
        better.count() < replicas.max(1)
    };
    cells.filter(is_mine).collect()
}

fn weight(cell: CellId, server: &str) -> [u8; 32] {
    Sha256::new().chain_update(cell.to_be_bytes()).chain_update(server).finalize().into()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;

    fn servers(count: usize) -> BTreeSet<String> {
        (0..count).map(|number| format!("s{number}")).collect()
    }

    /// The servers of each cell.
    fn assigned(servers: &BTreeSet<String>, replicas: usize) -> BTreeMap<CellId, BTreeSet<String>> {
        let mut assigned: BTreeMap<CellId, BTreeSet<String>> = BTreeMap::new();
        for server in servers {
            for cell in cells_of(server, 0..400, servers, replicas) {
                assigned.entry(cell).or_default().insert(server.clone());
            }
        }
        assigned
    }

    #[test]
    fn every_cell_is_at_as_many_servers_as_there_are_to_be_and_they_share_evenly() {
        for (count, replicas) in [(1, 1), (4, 1), (4, 2), (5, 3), (2, 4)] {
            let servers = servers(count);
            let assigned = assigned(&servers, replicas);
            assert_eq!(assigned.len(), 400);
            assert!(assigned.values().all(|servers| servers.len() == replicas.min(count)));
            let mean = 400 * replicas.min(count) / count;
            for server in &servers {
                let share = assigned.values().filter(|servers| servers.contains(server)).count();
                assert!(
                    share * 4 > mean * 3 && share * 3 < mean * 4,
                    "{server} has {share}, the mean is {mean}"
                );
            }
        }
    }

    #[test]
    fn a_server_that_goes_moves_only_its_share() {
        let all = servers(5);
        let before = assigned(&all, 2);
        for gone in &all {
            let left: BTreeSet<String> = all.iter().filter(|name| *name != gone).cloned().collect();
            let after = assigned(&left, 2);
            for (cell, servers) in &before {
                if servers.contains(gone) {
                    assert!(servers.iter().all(|server| server == gone || after[cell].contains(server)));
                } else {
                    assert_eq!(*servers, after[cell]);
                }
            }
        }
    }
}
