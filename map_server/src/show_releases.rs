//! What changed between the releases of a map, and what a candidate would change, for the page.

use std::sync::Arc;
use std::time::Duration;

use releases::{
    CandidateState, Release, ReleaseChoice, ReleaseError, ReleaseStore, Stage, candidate_state,
    keyframe_difference,
};
use viewer::{ViewedChange, ViewedChanges, Viewer};

/// A release that was found and is not served yet is looked for again after this time.
const SOON: Duration = Duration::from_secs(1);
/// So often in a row: what is not served then was refused, or takes long to load.
const SOON_LOOKS: u32 = 20;

/// Compares the releases of one map.
pub(crate) struct ReleaseArtist {
    viewer: Arc<Viewer>,
    name: String,
    store: ReleaseStore,
    choice: ReleaseChoice,
    /// Versions of the map, of the release before and of the candidate that are shown.
    shown: Option<(u64, Option<u64>, Option<u64>)>,
    awaited: Awaited,
}

/// The release that was found and is not served yet.
#[derive(Default)]
struct Awaited {
    version: u64,
    looks: u32,
}

impl Awaited {
    /// Notes that a version is not served yet.
    ///
    /// # Returns
    /// Whether that is likely to change soon.
    fn is_due_soon(&mut self, version: u64) -> bool {
        if self.version != version {
            *self = Self { version, looks: 0 };
        }
        self.looks = self.looks.saturating_add(1);
        self.looks <= SOON_LOOKS
    }
}

impl ReleaseArtist {
    /// # Arguments
    /// * `name`: under which the map is shown.
    /// * `choice`: which of the store's releases its server follows.
    pub(crate) fn new(viewer: Arc<Viewer>, name: String, store: ReleaseStore, choice: ReleaseChoice) -> Self {
        Self { viewer, name, store, choice, shown: None, awaited: Awaited::default() }
    }

    /// Looks for releases and candidates after each `period`, until it is cancelled.
    pub(crate) async fn follow(mut self, period: Duration) {
        loop {
            let rest = match self.look().await {
                Ok(true) => period,
                Ok(false) => SOON.min(period),
                Err(error) => {
                    tracing::debug!(map = self.name, "what changed is not shown: {error}");
                    period
                }
            };
            tokio::time::sleep(rest).await;
        }
    }

    /// Shows what changed.
    ///
    /// # Returns
    /// `false` while the release that is followed is being loaded, and is to be looked for again soon.
    async fn look(&mut self) -> Result<bool, ReleaseError> {
        let Some(served) = self.choice.followed(&self.store).await? else { return Ok(true) };
        let version = served.map.version;
        if self.viewer.version(&self.name) != Some(version) {
            return Ok(!self.awaited.is_due_soon(version));
        }
        self.awaited = Awaited::default();
        let former = self.former(&served).await?;
        let proposed = self.proposed(&served).await?;
        let version_of = |release: &Option<Release>| release.as_ref().map(|release| release.map.version);
        let found = (version, version_of(&former), version_of(&proposed));
        if self.shown == Some(found) {
            return Ok(true);
        }
        let since = match &former {
            Some(former) => Some(self.change(former.title(), former, &served).await?),
            None => None,
        };
        let candidate = match &proposed {
            Some(proposed) => Some(self.change(proposed.title(), &served, proposed).await?),
            None => None,
        };
        self.viewer.set_changes(&self.name, &ViewedChanges { version, since, candidate });
        self.shown = Some(found);
        Ok(true)
    }

    async fn change(
        &self,
        release: String,
        before: &Release,
        now: &Release,
    ) -> Result<ViewedChange, ReleaseError> {
        Ok(ViewedChange { release, difference: keyframe_difference(&self.store, before, now).await? })
    }

    /// The live release before the one that is served; `None` for the first one, and where it was cleaned away.
    async fn former(&self, served: &Release) -> Result<Option<Release>, ReleaseError> {
        if served.number <= 1 {
            return Ok(None);
        }
        match self.store.release(served.number - 1).await {
            Ok(former) => Ok(Some(former)),
            Err(ReleaseError::NoRelease { .. }) => Ok(None),
            Err(error) => Err(error),
        }
    }

    /// The newest candidate, where nothing was decided about it and the server does not serve it.
    async fn proposed(&self, served: &Release) -> Result<Option<Release>, ReleaseError> {
        let Some(number) = self.store.candidate_numbers().await?.pop() else { return Ok(None) };
        if served.stage == Stage::Candidate && served.candidate == Some(number) {
            return Ok(None);
        }
        let proposed = self.store.candidate(number).await?;
        let newest = self.store.newest().await?;
        let state = candidate_state(&self.store, &proposed, newest.as_ref()).await?;
        Ok((state == CandidateState::Open).then_some(proposed))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_release_that_is_never_served_is_looked_for_rarely_and_the_next_one_soon_again() {
        let mut awaited = Awaited::default();
        let soon = (0..100).filter(|_| awaited.is_due_soon(7)).count();
        assert_eq!(soon, SOON_LOOKS as usize);
        assert!(!awaited.is_due_soon(7) && awaited.is_due_soon(8));
    }
}
