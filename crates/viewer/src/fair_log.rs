//! A log of limited length that is fair to those who are logged.

use std::collections::{BTreeMap, VecDeque};

/// The last entries of several owners. Where it is full, whoever has most entries loses the oldest of them: an owner that
/// is noted often does not displace the others.
#[derive(Debug)]
pub(crate) struct FairLog<T> {
    owners: BTreeMap<String, VecDeque<(u64, T)>>,
    length: usize,
    capacity: usize,
    next: u64,
}

impl<T> FairLog<T> {
    pub(crate) fn new(capacity: usize) -> Self {
        Self { owners: BTreeMap::new(), length: 0, capacity, next: 1 }
    }

    /// The number that the next entry gets; numbers grow.
    pub(crate) fn next_number(&self) -> u64 {
        self.next
    }

    pub(crate) fn add(&mut self, owner: &str, entry: T) {
        let number = self.next;
        self.next += 1;
        match self.owners.get_mut(owner) {
            Some(entries) => entries.push_back((number, entry)),
            None => {
                self.owners.insert(owner.to_owned(), VecDeque::from([(number, entry)]));
            }
        }
        self.length += 1;
        while self.length > self.capacity {
            self.evict();
        }
    }

    fn evict(&mut self) {
        let oldest = |entries: &VecDeque<(u64, T)>| entries.front().map_or(0, |(number, _)| *number);
        let rank = |entries: &VecDeque<(u64, T)>| (entries.len(), std::cmp::Reverse(oldest(entries)));
        let most =
            self.owners.iter().max_by_key(|(_, entries)| rank(entries)).map(|(owner, _)| owner.clone());
        let Some(owner) = most else { return };
        if let Some(entries) = self.owners.get_mut(&owner) {
            entries.pop_front();
            self.length -= 1;
            if entries.is_empty() {
                self.owners.remove(&owner);
            }
        }
    }

    /// Removes the entries of an owner.
    pub(crate) fn remove(&mut self, owner: &str) {
        self.length -= self.owners.remove(owner).map_or(0, |entries| entries.len());
    }

    /// The entries of an owner with their numbers, in the order in which they came.
    pub(crate) fn of(&self, owner: &str) -> impl Iterator<Item = &(u64, T)> + use<'_, T> {
        self.owners.get(owner).into_iter().flatten()
    }

    /// The entries of all owners with their numbers.
    pub(crate) fn all(&self) -> impl Iterator<Item = &(u64, T)> {
        self.owners.values().flatten()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whoever_is_noted_most_loses_its_oldest_and_the_length_is_limited() {
        let mut log = FairLog::new(10);
        for at in 0..3 {
            log.add("quiet", at);
        }
        for at in 0..10_000 {
            log.add("loud", at);
            assert!(log.all().count() <= 10);
        }
        let of = |owner| log.of(owner).map(|(_, entry)| *entry).collect::<Vec<_>>();
        assert_eq!(of("quiet"), [0, 1, 2]);
        assert_eq!(of("loud"), (9_993..10_000).collect::<Vec<_>>());
        log.remove("loud");
        (0..7).for_each(|at| log.add("other", at));
        assert_eq!(log.all().count(), 10, "its places are free");
    }

    #[test]
    fn owners_that_are_forgotten_leave_nothing() {
        let mut log = FairLog::new(10);
        for at in 0..10_000 {
            log.add(&format!("r{at}"), at);
        }
        assert_eq!(log.owners.len(), 10);
        assert_eq!(log.all().map(|(number, _)| *number).max(), Some(log.next_number() - 1));
    }
}
