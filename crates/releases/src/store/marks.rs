//! Marks of programs that remove segments, and the clock that dates what is put.

use super::ReleaseStore;
use crate::error::{ReleaseError, with_causes};

const MARKS: &str = "cleaning";
const CLOCK: &str = "clock";

impl ReleaseStore {
    /// Puts a mark.
    ///
    /// # Returns
    /// When that was, s since 1970.
    pub(crate) async fn put_mark(&self, name: &str) -> Result<u64, ReleaseError> {
        self.put_dated(format!("{MARKS}/{name}")).await
    }

    pub(crate) async fn has_mark(&self, name: &str) -> Result<bool, ReleaseError> {
        Ok(self.head(&format!("{MARKS}/{name}")).await?.is_some())
    }

    /// Marks of programs that remove segments, and when they were put, s since 1970.
    pub(crate) async fn marks(&self) -> Result<Vec<(String, u64)>, ReleaseError> {
        self.dated(MARKS).await
    }

    pub(crate) async fn remove_mark(&self, name: &str) -> Result<(), ReleaseError> {
        self.remove(format!("{MARKS}/{name}")).await
    }

    /// The time, s since 1970, by the clock that dates what is put: that of this machine may differ.
    ///
    /// # Arguments
    /// * `name`: of an object that nobody else puts. It is removed; where it cannot be, whoever cleans does it.
    pub(crate) async fn now_s(&self, name: &str) -> Result<u64, ReleaseError> {
        let now_s = self.put_dated(format!("{CLOCK}/{name}")).await?;
        if let Err(error) = self.remove_clock_object(name).await {
            tracing::debug!("an object that told the time stays: {}", with_causes(&error));
        }
        Ok(now_s)
    }

    /// Objects that told somebody the time and stayed, and when they were put, s since 1970.
    pub(crate) async fn clock_objects(&self) -> Result<Vec<(String, u64)>, ReleaseError> {
        self.dated(CLOCK).await
    }

    pub(crate) async fn remove_clock_object(&self, name: &str) -> Result<(), ReleaseError> {
        self.remove(format!("{CLOCK}/{name}")).await
    }
}
