//! How the difference of two maps is printed.

use map::difference::{ElementCounts, MapDifference};
use map::sessions::SessionDifference;

/// So many places are printed; JSON has all of them.
const MAX_PLACES: usize = 20;

/// Prints how many elements are new, gone or moved, and where.
pub fn print_difference(difference: &MapDifference) {
    println!("{:<30} {:>8} {:>8} {:>8}   moved by, m: median, largest", "", "new", "gone", "moved");
    print_counts("keyframes", &difference.keyframes);
    print_counts("landmarks", &difference.landmarks);
    if difference.places.is_empty() {
        return;
    }
    println!("by place, m");
    for place in difference.places.iter().take(MAX_PLACES) {
        let [x, y, z] = place.centre_m;
        let at = format!("({x:.1}, {y:.1}, {z:.1})");
        print_counts(&format!("  {at:<17} keyframes"), &place.keyframes);
        print_counts(&format!("  {:<17} landmarks", ""), &place.landmarks);
    }
    if let Some(more) = difference.places.len().checked_sub(MAX_PLACES).filter(|more| *more > 0) {
        println!("  and {more} more places: --json lists all");
    }
}

fn print_counts(name: &str, counts: &ElementCounts) {
    let motion = counts
        .motion
        .map_or_else(String::new, |motion| format!("   {:.3}, {:.3}", motion.median_m, motion.largest_m));
    println!("{name:<30} {:>8} {:>8} {:>8}{motion}", counts.added, counts.removed, counts.moved);
}

/// Prints which sessions came and went, a line each.
pub fn print_sessions(indent: &str, difference: &SessionDifference) {
    for (what, sessions) in [("new", &difference.added), ("gone", &difference.removed)] {
        for session in sessions {
            println!("{indent}session {what:<5} {session}");
        }
    }
}
