//! A bounded queue that is fair to its clients: self-clocked fair queueing (Golestani, INFOCOM 1994) by bytes, in two levels.
//!
//! A job's finish tag is the start tag of its client plus its bytes; the job with the smallest finish tag is next, and sets the
//! clock, below which no start tag begins. A client that sends much waits behind itself: whoever sends little is served before it.
//! What a job costs beyond its bytes is charged to its client afterwards. Where the queue is full, the newest job of the
//! client with the most waiting bytes gives way.
//!
//! Each client that is known has a share of its own. All that only state a name have one share together, and divide it among
//! their names in the same way: who invents names takes from those that do, and from nobody else.

use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;

/// Cost of a job beside its bytes: small ones are not free.
const BASE_COST: usize = 4096;
/// Bytes that count as much as a millisecond of a worker: an image of 1,000 binary features is 40 kB and takes about 10 ms.
const COST_A_MILLISECOND: usize = 4096;
/// Shares without a job are looked through where so many have come since the last time.
const IDLE_SHARES: usize = 64;

/// What a job of so many bytes counts.
pub(crate) fn cost_of(bytes: usize) -> usize {
    bytes.saturating_add(BASE_COST)
}

/// What a job costs beyond its bytes.
pub(crate) fn extra_cost(bytes: usize, elapsed: Duration) -> usize {
    let micros = usize::try_from(elapsed.as_micros()).unwrap_or(usize::MAX);
    (micros.saturating_mul(COST_A_MILLISECOND) / 1000).saturating_sub(cost_of(bytes))
}

/// What so many jobs of so many bytes together count.
pub(crate) fn capacity_of(length: usize, bytes: usize) -> usize {
    bytes.saturating_add(length.saturating_mul(BASE_COST))
}

/// Who sends a job.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Client {
    /// A session that is connected, or the subject of its certificate.
    Known(String),
    /// Whoever states this name.
    Stated(String),
}

impl Client {
    /// The share on the upper level.
    fn share(&self) -> ShareOf {
        match self {
            Client::Known(name) => ShareOf::Known(name.clone()),
            Client::Stated(_) => ShareOf::AllStated,
        }
    }

    fn name(&self) -> &str {
        match self {
            Client::Known(name) | Client::Stated(name) => name,
        }
    }
}

/// Whose a share is.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum ShareOf {
    Known(String),
    /// Of all who only state a name.
    AllStated,
}

struct Waiting<T> {
    cost: usize,
    job: T,
}

/// Jobs of one name.
struct Jobs<T> {
    /// Start tag of the first.
    start: u64,
    waiting: VecDeque<Waiting<T>>,
}

impl<T> Jobs<T> {
    fn finish(&self) -> Option<u64> {
        Some(self.start.saturating_add(self.waiting.front()?.cost as u64))
    }

    /// Waiting bytes.
    fn total(&self) -> usize {
        self.waiting.iter().map(|waiting| waiting.cost).sum()
    }
}

/// One share of the queue, of one name or of many.
struct Share<T> {
    start: u64,
    clock: u64,
    names: BTreeMap<String, Jobs<T>>,
}

impl<T> Share<T> {
    /// The name whose job is next.
    fn next(&self) -> Option<&String> {
        let waiting = self.names.iter().filter_map(|(name, jobs)| Some((jobs.finish()?, name)));
        Some(waiting.min()?.1)
    }

    fn finish(&self) -> Option<u64> {
        let first = self.names.get(self.next()?)?.waiting.front()?;
        Some(self.start.saturating_add(first.cost as u64))
    }

    fn total(&self) -> usize {
        self.names.values().map(Jobs::total).sum()
    }

    fn is_idle(&self) -> bool {
        self.names.values().all(|jobs| jobs.waiting.is_empty())
    }
}

/// Jobs of several clients.
pub(crate) struct FairQueue<T> {
    /// Those with waiting jobs, and those whose start tag the clock has not reached.
    shares: BTreeMap<ShareOf, Share<T>>,
    clock: u64,
    /// Names that came since the last time that idle ones were left out.
    names_added: usize,
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
        let shares = BTreeMap::new();
        Self { shares, clock: 0, names_added: 0, length: 0, cost: 0, max_length, max_cost }
    }

    /// Adds a job.
    ///
    /// # Returns
    /// The jobs that do not fit: this one, or newest ones of clients with more waiting bytes.
    pub(crate) fn put(&mut self, client: &Client, bytes: usize, job: T) -> Vec<T> {
        let cost = cost_of(bytes);
        if cost > self.max_cost {
            return vec![job];
        }
        let mut refused = Vec::new();
        while self.length == self.max_length || self.cost + cost > self.max_cost {
            let Some((share, name)) = self.heavier(client, cost) else {
                refused.push(job);
                return refused;
            };
            refused.extend(self.remove(&share, &name, VecDeque::pop_back).map(|waiting| waiting.job));
        }
        (self.length, self.cost) = (self.length + 1, self.cost + cost);
        self.leave_out_idle();
        let clock = self.clock;
        let share = self.shares.entry(client.share()).or_insert_with(|| Share {
            start: clock,
            clock: 0,
            names: BTreeMap::new(),
        });
        if share.is_idle() {
            share.start = share.start.max(clock);
        }
        let (clock, names_added) = (share.clock, &mut self.names_added);
        let jobs = share.names.entry(client.name().to_owned()).or_insert_with(|| {
            *names_added += 1;
            Jobs { start: clock, waiting: VecDeque::new() }
        });
        if jobs.waiting.is_empty() {
            jobs.start = jobs.start.max(clock);
        }
        jobs.waiting.push_back(Waiting { cost, job });
        refused
    }

    /// The next job.
    pub(crate) fn take(&mut self) -> Option<T> {
        let finishing = self.shares.iter().filter_map(|(key, share)| Some((share.finish()?, key)));
        let key = finishing.min()?.1.clone();
        let name = self.shares.get(&key)?.next()?.clone();
        let next = self.remove(&key, &name, VecDeque::pop_front)?;
        self.advance(&key, &name, next.cost);
        if let Some(share) = self.shares.get_mut(&key) {
            self.clock = self.clock.max(share.start);
            share.clock = share.clock.max(share.names.get(&name).map_or(0, |jobs| jobs.start));
        }
        Some(next.job)
    }

    /// Charges a client with what its job cost beyond its bytes.
    pub(crate) fn charge(&mut self, client: &Client, cost: usize) {
        self.advance(&client.share(), client.name(), cost);
    }

    /// Moves the start tags of a client.
    fn advance(&mut self, key: &ShareOf, name: &str, cost: usize) {
        let Some(share) = self.shares.get_mut(key) else { return };
        share.start = share.start.saturating_add(cost as u64);
        if let Some(jobs) = share.names.get_mut(name) {
            jobs.start = jobs.start.saturating_add(cost as u64);
        }
    }

    /// Whose newest job gives way to one of this cost of this client: `None` where no other has more waiting.
    fn heavier(&self, client: &Client, cost: usize) -> Option<(ShareOf, String)> {
        let own_key = client.share();
        let own = self.shares.get(&own_key).map_or(0, Share::total) + cost;
        let (total, key) = self.shares.iter().map(|(key, share)| (share.total(), key)).max()?;
        let is_other = *key != own_key && total > own;
        let share = self.shares.get(if is_other { key } else { &own_key })?;
        let (total, name) = share.names.iter().map(|(name, jobs)| (jobs.total(), name)).max()?;
        let own = share.names.get(client.name()).map_or(0, Jobs::total) + cost;
        (is_other || total > own).then(|| (if is_other { key.clone() } else { own_key }, name.clone()))
    }

    /// Forgets who has no job and no debt.
    fn leave_out_idle(&mut self) {
        if self.names_added < IDLE_SHARES {
            return;
        }
        self.names_added = 0;
        for share in self.shares.values_mut() {
            let clock = share.clock;
            share.names.retain(|_, jobs| !jobs.waiting.is_empty() || jobs.start > clock);
        }
        let clock = self.clock;
        self.shares.retain(|_, share| !share.is_idle() || share.start > clock);
    }

    fn remove(
        &mut self,
        share: &ShareOf,
        name: &str,
        pop: impl Fn(&mut VecDeque<Waiting<T>>) -> Option<Waiting<T>>,
    ) -> Option<Waiting<T>> {
        let removed = pop(&mut self.shares.get_mut(share)?.names.get_mut(name)?.waiting)?;
        (self.length, self.cost) = (self.length - 1, self.cost - removed.cost);
        Some(removed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Puts a job that names its client.
    fn put<'a>(queue: &mut FairQueue<&'a str>, client: &'a str, bytes: usize) -> Vec<&'a str> {
        queue.put(&Client::Known(client.to_owned()), bytes, client)
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

    #[test]
    fn whoever_invents_names_takes_from_those_that_do_and_not_from_a_session() {
        let mut queue = FairQueue::new(64, 1 << 30);
        let mut refused = 0;
        for k in 0..500 {
            refused += queue.put(&Client::Stated(format!("name {k}")), 30_000, "stated").len();
        }
        assert_eq!(refused, 500 - 64);
        for _ in 0..3 {
            // In its place one of the others gives way, and it waits for one job of theirs at most.
            assert_eq!(queue.put(&Client::Known("robot".into()), 30_000, "robot"), ["stated"]);
            let first = [queue.take(), queue.take()];
            assert!(first.contains(&Some("robot")), "{first:?}");
            queue.put(&Client::Stated("one more".into()), 30_000, "stated");
            queue.put(&Client::Stated("and one".into()), 30_000, "stated");
        }
    }

    #[test]
    fn what_a_job_cost_beyond_its_bytes_is_charged_to_whoever_sent_it() {
        let mut queue = FairQueue::new(100, 1 << 30);
        let (costly, cheap) = (Client::Known("costly".into()), Client::Stated("cheap".into()));
        queue.put(&costly, 1000, "costly");
        queue.take();
        let extra = extra_cost(1000, Duration::from_millis(250));
        assert_eq!(extra, 250 * COST_A_MILLISECOND - cost_of(1000));
        for _ in 0..20 {
            queue.put(&costly, 1000, "costly");
            queue.put(&cheap, 1000, "cheap");
        }
        queue.charge(&costly, extra);
        let first: Vec<_> = std::iter::from_fn(|| queue.take()).take(20).collect();
        assert!(first.iter().all(|job| *job == "cheap"), "{first:?}");
        assert_eq!(queue.take(), Some("costly"), "a debt is a delay, not a refusal");
    }

    #[test]
    fn names_are_forgotten_once_they_have_nothing_waiting() {
        let mut queue = FairQueue::new(8, 1 << 30);
        for k in 0..10_000 {
            queue.put(&Client::Stated(format!("name {k}")), 10, k);
            queue.put(&Client::Known(format!("session {k}")), 10, k);
            queue.take();
            queue.take();
        }
        let names: usize = queue.shares.values().map(|share| share.names.len()).sum();
        assert!(names <= 2 * IDLE_SHARES + 2, "{names}");
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
                let name = client.to_string();
                let sender = if *client < 2 { Client::Known(name) } else { Client::Stated(name) };
                refused.extend(queue.put(&sender, *bytes, (*client, index)));
                queue.charge(&sender, bytes % 7000);
                prop_assert!(queue.length <= 8 && queue.cost <= 400_000 + 8 * BASE_COST);
                if *takes {
                    taken.extend(queue.take());
                }
            }
            taken.extend(std::iter::from_fn(|| queue.take()));
            prop_assert!(queue.length == 0 && queue.shares.values().all(Share::is_idle) && queue.cost == 0);
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
