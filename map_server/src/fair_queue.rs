//! A bounded queue that is fair to its clients: self-clocked fair queueing (Golestani, INFOCOM 1994) by bytes.
//!
//! A job's finish tag is the larger of the queue's clock and the client's last tag, plus its bytes; the job with the smallest
//! tag is next, and sets the clock. A client that sends much waits behind itself: whoever sends little is served before it.
//! Where the queue is full, the newest job of the client with the most waiting bytes gives way.

use std::collections::{BTreeMap, VecDeque};

/// Cost of a job beside its bytes: small ones are not free.
const BASE_COST: usize = 4096;

/// What a job of so many bytes counts.
pub(crate) fn cost_of(bytes: usize) -> usize {
    bytes.saturating_add(BASE_COST)
}

/// What so many jobs of so many bytes together count.
pub(crate) fn capacity_of(length: usize, bytes: usize) -> usize {
    bytes.saturating_add(length.saturating_mul(BASE_COST))
}

struct Waiting<T> {
    finish: u64,
    cost: usize,
    job: T,
}

/// Jobs of several clients.
pub(crate) struct FairQueue<T> {
    /// Clients with waiting jobs only.
    clients: BTreeMap<String, VecDeque<Waiting<T>>>,
    clock: u64,
    length: usize,
    cost: usize,
    max_length: usize,
    max_cost: usize,
}

impl<T> FairQueue<T> {
    /// A queue of at most `length` jobs of `bytes` bytes together.
    pub(crate) fn new(length: usize, bytes: usize) -> Self {
        let max_length = length.max(1);
        let max_cost = capacity_of(max_length, bytes);
        Self { clients: BTreeMap::new(), clock: 0, length: 0, cost: 0, max_length, max_cost }
    }

    /// Adds a job.
    ///
    /// # Returns
    /// The jobs that do not fit: this one, or newest ones of clients with more waiting bytes.
    pub(crate) fn put(&mut self, client: &str, bytes: usize, job: T) -> Vec<T> {
        let cost = cost_of(bytes);
        if cost > self.max_cost {
            return vec![job];
        }
        let mut refused = Vec::new();
        while self.length == self.max_length || self.cost + cost > self.max_cost {
            let own = self.clients.get(client).map_or(0, total) + cost;
            let heaviest =
                self.clients.iter().map(|(name, jobs)| (total(jobs), name)).max_by_key(|(sum, _)| *sum);
            let Some(name) = heaviest.filter(|(sum, _)| *sum > own).map(|(_, name)| name.clone()) else {
                refused.push(job);
                return refused;
            };
            refused.extend(self.remove(&name, VecDeque::pop_back).map(|waiting| waiting.job));
        }
        (self.length, self.cost) = (self.length + 1, self.cost + cost);
        let jobs = self.clients.entry(client.to_owned()).or_default();
        let start = jobs.back().map_or(self.clock, |last| last.finish);
        jobs.push_back(Waiting { finish: start.saturating_add(cost as u64), cost, job });
        refused
    }

    /// The next job.
    pub(crate) fn take(&mut self) -> Option<T> {
        let first = |jobs: &VecDeque<Waiting<T>>| jobs.front().map(|waiting| waiting.finish);
        let client = self.clients.iter().min_by_key(|(_, jobs)| first(jobs)).map(|(name, _)| name.clone())?;
        let next = self.remove(&client, VecDeque::pop_front)?;
        self.clock = next.finish;
        Some(next.job)
    }

    /// Whether no job waits.
    pub(crate) fn is_empty(&self) -> bool {
        self.length == 0
    }

    fn remove(
        &mut self,
        client: &str,
        pop: impl Fn(&mut VecDeque<Waiting<T>>) -> Option<Waiting<T>>,
    ) -> Option<Waiting<T>> {
        let jobs = self.clients.get_mut(client)?;
        let removed = pop(jobs)?;
        if jobs.is_empty() {
            self.clients.remove(client);
        }
        (self.length, self.cost) = (self.length - 1, self.cost - removed.cost);
        Some(removed)
    }
}

/// Waiting bytes of a client.
fn total<T>(jobs: &VecDeque<Waiting<T>>) -> usize {
    jobs.iter().map(|waiting| waiting.cost).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Puts a job that names its client.
    fn put<'a>(queue: &mut FairQueue<&'a str>, client: &'a str, bytes: usize) -> Vec<&'a str> {
        queue.put(client, bytes, client)
    }

    #[test]
    fn whoever_sends_little_does_not_wait_for_whoever_sends_much() {
        let mut queue = FairQueue::new(100, 100 << 20);
        for _ in 0..20 {
            assert!(put(&mut queue, "heavy", 1 << 20).is_empty());
        }
        assert_eq!(queue.take(), Some("heavy"));
        for _ in 0..3 {
            put(&mut queue, "light", 30_000);
        }
        assert_eq!(
            std::iter::from_fn(|| queue.take()).take(4).collect::<Vec<_>>(),
            ["light", "light", "light", "heavy"]
        );
    }

    #[test]
    fn equal_clients_take_turns() {
        let mut queue = FairQueue::new(100, 100 << 20);
        for client in ["a", "a", "a", "b", "b", "b"] {
            put(&mut queue, client, 1000);
        }
        assert_eq!(std::iter::from_fn(|| queue.take()).collect::<Vec<_>>(), ["a", "b", "a", "b", "a", "b"]);
    }

    #[test]
    fn in_a_full_queue_the_heaviest_client_gives_way_and_not_the_newcomer() {
        let mut queue = FairQueue::new(4, 1 << 30);
        for _ in 0..4 {
            put(&mut queue, "heavy", 1 << 20);
        }
        assert_eq!(put(&mut queue, "heavy", 1 << 20), ["heavy"]);
        assert_eq!(put(&mut queue, "light", 1000), ["heavy"]);
        assert_eq!(queue.take(), Some("light"));
    }

    proptest! {
        /// Nothing is lost or made up, the limits hold, each client's jobs keep their order, and a client is refused only
        /// where no other has more waiting.
        #[test]
        fn every_job_is_taken_once_in_order_or_refused(
            steps in proptest::collection::vec((0_usize..4, 0_usize..200_000, any::<bool>()), 1..200),
        ) {
            let mut queue = FairQueue::new(8, 400_000);
            let (mut taken, mut refused) = (Vec::new(), Vec::new());
            for (index, (client, bytes, takes)) in steps.iter().enumerate() {
                refused.extend(queue.put(&client.to_string(), *bytes, (*client, index)));
                prop_assert!(queue.length <= 8 && queue.cost <= 400_000 + 8 * BASE_COST);
                if *takes {
                    taken.extend(queue.take());
                }
            }
            taken.extend(std::iter::from_fn(|| queue.take()));
            prop_assert!(queue.is_empty() && queue.clients.is_empty() && queue.cost == 0);
            for client in 0..4 {
                let own: Vec<_> = taken.iter().filter(|(of, _)| *of == client).map(|(_, index)| *index).collect();
                prop_assert!(own.is_sorted());
            }
            let mut all: Vec<_> = taken.iter().chain(&refused).map(|(_, index)| *index).collect();
            all.sort_unstable();
            prop_assert_eq!(all, (0..steps.len()).collect::<Vec<_>>());
        }
    }
}
