//! The noise of a map's pixels, by that of its sessions.
//!
//! A map has one standard deviation for all of its pixels, [`MapMetadata::sigma_px`]: with it a robot weighs whatever pixel it was matched to,
//! and a landmark's position has the covariance that follows from it and from the poses. It is never optimistic where it is that of the
//! noisiest session of which the map has keyframes. A session whose keyframes are all taken out has no pixels in the map, so that its noise
//! goes with it.

use super::session::Session;
use crate::model::MapMetadata;

impl MapMetadata {
    /// The standard deviation that covers all pixels of the map (px): of the noisiest session that has keyframes, by the counts of the ledger. Where
    /// that of one of them is not known, at least what the map states.
    ///
    /// # Example
    /// ```
    /// use map::MapMetadata;
    /// use protocol::DescriptorKind;
    ///
    /// let info = MapMetadata::new("hall", "example", DescriptorKind::Binary, 32);
    /// assert_eq!(info.covering_sigma_px(), info.sigma_px); // no session is known
    /// ```
    pub fn covering_sigma_px(&self) -> f64 {
        let present = self.sessions.iter().filter(|session| session.keyframes > 0);
        let noisiest =
            present.map(|session| session.sigma_px.unwrap_or(self.sigma_px)).max_by(f64::total_cmp);
        noisiest.unwrap_or(self.sigma_px)
    }

    /// The standard deviation of the pixels of the session that the map began with (px), which no later one can change. Where it is not known,
    /// what the map states.
    pub fn first_sigma_px(&self) -> f64 {
        self.sessions.first().and_then(|session| session.sigma_px).unwrap_or(self.sigma_px)
    }

    /// The ledger with the noise of all sessions: that of the map, which covers them, for those of which it is not known.
    pub fn sessions_with_noise(&self) -> Vec<Session> {
        let known = |session: &Session| session.sigma_px.or(Some(self.sigma_px));
        self.sessions.iter().map(|session| Session { sigma_px: known(session), ..session.clone() }).collect()
    }
}
