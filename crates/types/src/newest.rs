//! Queues that keep the newest.

use std::collections::VecDeque;

/// Appends to a queue that holds so many at most: where it is full, the oldest is left out.
///
/// # Returns
/// Whether one was left out.
///
/// ```
/// let mut queue = std::collections::VecDeque::from([1, 2]);
/// assert!(!types::push_newest(&mut queue, 3, 3));
/// assert!(types::push_newest(&mut queue, 4, 3));
/// assert_eq!(queue, [2, 3, 4]);
/// ```
pub fn push_newest<T>(queue: &mut VecDeque<T>, item: T, most: usize) -> bool {
    let is_full = queue.len() >= most;
    if is_full {
        queue.pop_front();
    }
    queue.push_back(item);
    is_full
}
