//! A query of a robot, from its receipt to the answer of one cell.
//!
//! A worker decodes the query and finds out which cells it could be about; asking these takes no worker, so that servers that ask
//! each other never wait for each other's workers.

use std::collections::BTreeSet;
use std::sync::{Arc, PoisonError, RwLock};
use std::time::{Duration, Instant};

use client::{CellClient, CellPlacement, ClientError, ForwardedQuery};
use protocol::{
    CellLocalizeReply, CellMatchReply, CellPlace, ErrorCode, ErrorReply, FeatureSet, KeyframeId,
    LocalizeReply, LocalizeRequest, MapIdentity, MatchOutcome, MatchReply, MatchRequest, MatchStatus,
    Message, PosePrior, keys,
};
use recognition::{PartResult, QueryError, RecognitionOptions, RecognizedPlace, choose_part};
use releases::CellId;
use tokio::task::JoinSet;
use zenoh::query::Query;

use super::directory::CellDirectory;
use crate::handlers::{self, Kind};

/// How long the cells of a query are asked: less than a robot waits for its answer.
const CELL_DEADLINE: Duration = Duration::from_millis(1500);
/// Keyframes that are fetched from cells at the same time for a query for all of them.
const KEYFRAMES_AT_ONCE: usize = 16;

/// A map that is served by cells, at this server and at others.
pub(crate) struct RoutedMap {
    pub(crate) name: String,
    client: CellClient,
    options: RecognitionOptions,
    directory: RwLock<Arc<CellDirectory>>,
    /// The cells that this server has.
    here: RwLock<Arc<BTreeSet<CellId>>>,
}

/// A query and the cells that are asked first.
pub(crate) struct Plan {
    query: Query,
    received: Instant,
    forwarded: ForwardedQuery,
    directory: Arc<CellDirectory>,
    wanted: Wanted,
}

enum Wanted {
    Match(Arc<MatchRequest>, Vec<CellId>),
    Localize(Arc<LocalizeRequest>, Vec<CellId>),
    Info,
    Keyframe(KeyframeId),
    AllKeyframes,
}

impl RoutedMap {
    pub(crate) fn new(
        name: &str,
        client: CellClient,
        options: RecognitionOptions,
        directory: Arc<CellDirectory>,
    ) -> Self {
        let here = RwLock::new(Arc::default());
        Self { name: name.to_owned(), client, options, directory: RwLock::new(directory), here }
    }

    pub(crate) fn directory(&self) -> Arc<CellDirectory> {
        Arc::clone(&self.directory.read().unwrap_or_else(PoisonError::into_inner))
    }

    pub(crate) fn set_directory(&self, directory: Arc<CellDirectory>) {
        *self.directory.write().unwrap_or_else(PoisonError::into_inner) = directory;
    }

    pub(crate) fn set_here(&self, cells: BTreeSet<CellId>) {
        *self.here.write().unwrap_or_else(PoisonError::into_inner) = Arc::new(cells);
    }

    fn placement(&self, cell: CellId) -> CellPlacement {
        let here = self.here.read().unwrap_or_else(PoisonError::into_inner);
        if here.contains(&cell) { CellPlacement::Here } else { CellPlacement::Elsewhere }
    }

    /// Decodes a query and chooses the cells that are asked first. Takes a processor for a millisecond or more.
    pub(crate) fn plan(&self, query: &Query, kind: Kind, received: Instant) -> Result<Plan, ErrorReply> {
        let directory = self.directory();
        let first = |features: &FeatureSet, prior: Option<&PosePrior>| {
            directory.first(features, prior).map_err(|error| handlers::query_error(&self.name, &error))
        };
        let wanted = match kind {
            Kind::Match => {
                let request: MatchRequest = handlers::decode(query)?;
                let cells = first(&request.features, request.prior.as_ref())?;
                Wanted::Match(Arc::new(request), cells)
            }
            Kind::Localize => {
                let request: LocalizeRequest = handlers::decode(query)?;
                let cells = first(&request.features, request.prior.as_ref())?;
                Wanted::Localize(Arc::new(request), cells)
            }
            Kind::Info => Wanted::Info,
            Kind::Keyframes => match handlers::asked_keyframe(query)? {
                Some(id) => Wanted::Keyframe(id),
                None => Wanted::AllKeyframes,
            },
        };
        let client = query.parameters().get(keys::CLIENT_PARAMETER).unwrap_or_default().to_owned();
        let payload = query.payload().cloned().unwrap_or_default();
        let encoding = query.encoding().cloned().unwrap_or_default();
        let forwarded = ForwardedQuery { payload, encoding, client };
        Ok(Plan { query: query.clone(), received, forwarded, directory, wanted })
    }

    /// Asks the cells and sends the answer. An error is returned, not yet sent.
    pub(crate) async fn answer(&self, plan: Plan) -> Result<(), ErrorReply> {
        let Plan { query, received, forwarded, directory, wanted } = plan;
        match wanted {
            Wanted::Match(request, first) => {
                let asked = Asked { directory, forwarded, has_prior: request.prior.is_some() };
                let then = Arc::clone(&asked.directory);
                let then =
                    move |first: &[CellId]| then.then(&request.features, request.prior.as_ref(), first);
                let found = self.search::<CellMatchReply>(&asked, first, then).await?;
                let key = keys::map_match(&self.name).map_err(|error| handlers::internal(&error))?;
                send_all(query, key, match_replies(found, received)).await
            }
            Wanted::Localize(request, first) => {
                let asked = Asked { directory, forwarded, has_prior: request.prior.is_some() };
                let then = Arc::clone(&asked.directory);
                let then =
                    move |first: &[CellId]| then.then(&request.features, request.prior.as_ref(), first);
                let found = self.search::<CellLocalizeReply>(&asked, first, then).await?;
                let key = keys::map_localize(&self.name).map_err(|error| handlers::internal(&error))?;
                send_all(query, key, vec![localize_reply(found)]).await
            }
            Wanted::Info => {
                let key = keys::map_info(&self.name).map_err(|error| handlers::internal(&error))?;
                send_all(query, key, vec![directory.info_reply(&self.name)]).await
            }
            Wanted::Keyframe(id) => {
                let Some(cell) = directory.cell_of(id) else {
                    return Err(handlers::unknown_keyframe(&self.name, id));
                };
                self.send_keyframe(query, cell, id, forwarded.client).await
            }
            Wanted::AllKeyframes => {
                let mut fetching = JoinSet::new();
                for (cell, id) in directory.keyframes() {
                    if fetching.len() >= KEYFRAMES_AT_ONCE
                        && let Some(Ok(Err(error))) = fetching.join_next().await
                    {
                        return Err(error);
                    }
                    let (client, placement) = (self.client.clone(), self.placement(cell));
                    let (name, query, asking) = (self.name.clone(), query.clone(), forwarded.client.clone());
                    fetching.spawn(async move {
                        send_keyframe(&client, &name, query, (cell, placement), id, &asking).await
                    });
                }
                while let Some(sent) = fetching.join_next().await {
                    sent.map_err(|error| handlers::internal(&error))??;
                }
                Ok(())
            }
        }
    }

    async fn send_keyframe(
        &self,
        query: Query,
        cell: CellId,
        id: KeyframeId,
        client: String,
    ) -> Result<(), ErrorReply> {
        let at = (cell, self.placement(cell));
        send_keyframe(&self.client, &self.name, query, at, id, &client).await
    }

    /// Asks the first cells, and where none of them shows the place the next ones.
    async fn search<R: CellReply>(
        &self,
        asked: &Asked,
        first: Vec<CellId>,
        then: impl FnOnce(&[CellId]) -> Result<Vec<CellId>, QueryError> + Send + 'static,
    ) -> Result<Found<R>, ErrorReply> {
        let mut replies: Vec<R> = self.ask(asked, &first).await?;
        let outcome = match self.choose(&replies) {
            Ok(at) => return Ok(Found::at(replies, at)),
            Err(outcome) => outcome,
        };
        if matches!(outcome, MatchOutcome::Ambiguous | MatchOutcome::TooFewFeatures) {
            return Ok(Found { outcome, winner: None, others: replies });
        }
        let ranking = tokio::task::spawn_blocking(move || then(&first));
        let then = ranking.await.map_err(|error| handlers::internal(&error))?;
        let then = then.map_err(|error| handlers::query_error(&self.name, &error))?;
        replies.extend(self.ask(asked, &then).await?);
        Ok(match self.choose(&replies) {
            Ok(at) => Found::at(replies, at),
            Err(outcome) => Found { outcome, winner: None, others: replies },
        })
    }

    fn choose<R: CellReply>(&self, replies: &[R]) -> Result<usize, MatchOutcome> {
        let places: Vec<Option<RecognizedPlace>> = replies
            .iter()
            .map(|reply| {
                let CellPlace { global_from_camera, features } = reply.place()?;
                Some(RecognizedPlace::new(*global_from_camera, *features as usize))
            })
            .collect();
        let results = replies.iter().zip(&places);
        let results: Vec<PartResult<'_>> = results
            .map(|(reply, place)| PartResult { outcome: reply.outcome(), place: place.as_ref() })
            .collect();
        choose_part(&results, &self.options)
    }

    /// The replies of cells. Where a cell does not answer there is no answer, since it could be of that cell; only near a prior
    /// those of the others will do, if one of them shows the place.
    async fn ask<R: CellReply>(&self, asked: &Asked, cells: &[CellId]) -> Result<Vec<R>, ErrorReply> {
        let deadline = Instant::now() + CELL_DEADLINE;
        let mut asking = JoinSet::new();
        for (at, &cell) in cells.iter().enumerate() {
            let (client, placement, forwarded) =
                (self.client.clone(), self.placement(cell), asked.forwarded.clone());
            asking.spawn(async move { (at, R::ask(&client, cell, placement, &forwarded, deadline).await) });
        }
        let mut replies: Vec<Option<R>> = cells.iter().map(|_| None).collect();
        let mut failure = None;
        while let Some(joined) = asking.join_next().await {
            let (at, reply) = joined.map_err(|error| handlers::internal(&error))?;
            match reply {
                Ok(reply) if reply.version() == (asked.directory.identity(), asked.directory.version()) => {
                    replies[at] = Some(reply);
                }
                Ok(_) => {
                    let message = format!("map {} is changing over to another version, ask again", self.name);
                    failure = Some(ErrorReply::new(ErrorCode::Busy, message));
                }
                Err(ClientError::Refused(reply)) if reply.code != ErrorCode::Busy => return Err(reply),
                Err(error) => {
                    let message = format!("cell {} of map {}: {error}", cells[at], self.name);
                    failure = Some(ErrorReply::new(ErrorCode::Busy, message));
                }
            }
        }
        let replies: Vec<R> = replies.into_iter().flatten().collect();
        match failure {
            Some(failure) if !asked.has_prior || self.choose(&replies).is_err() => Err(failure),
            _ => Ok(replies),
        }
    }
}

/// A query on its way to cells.
struct Asked {
    directory: Arc<CellDirectory>,
    forwarded: ForwardedQuery,
    has_prior: bool,
}

/// What the cells found.
struct Found<R> {
    outcome: MatchOutcome,
    winner: Option<R>,
    others: Vec<R>,
}

impl<R> Found<R> {
    fn at(mut replies: Vec<R>, at: usize) -> Self {
        let winner = Some(replies.swap_remove(at));
        Self { outcome: MatchOutcome::Matched, winner, others: replies }
    }
}

/// The answer of a cell to a kind of query.
trait CellReply: Message + Send + 'static {
    fn outcome(&self) -> MatchOutcome;
    fn place(&self) -> Option<&CellPlace>;
    fn version(&self) -> (MapIdentity, u64);
    fn ask(
        client: &CellClient,
        cell: CellId,
        placement: CellPlacement,
        query: &ForwardedQuery,
        deadline: Instant,
    ) -> impl Future<Output = Result<Self, ClientError>> + Send;
}

impl CellReply for CellMatchReply {
    fn outcome(&self) -> MatchOutcome {
        status_of(&self.replies).map_or(MatchOutcome::NoMatch, |status| status.outcome)
    }

    fn place(&self) -> Option<&CellPlace> {
        self.place.as_ref()
    }

    fn version(&self) -> (MapIdentity, u64) {
        let status = status_of(&self.replies).map(|status| (status.map_identity, status.map_version));
        status.unwrap_or((MapIdentity::from_bytes([0; 16]), 0))
    }

    async fn ask(
        client: &CellClient,
        cell: CellId,
        placement: CellPlacement,
        query: &ForwardedQuery,
        deadline: Instant,
    ) -> Result<Self, ClientError> {
        client.match_image(cell, placement, query, deadline).await
    }
}

impl CellReply for CellLocalizeReply {
    fn outcome(&self) -> MatchOutcome {
        self.reply.outcome
    }

    fn place(&self) -> Option<&CellPlace> {
        self.place.as_ref()
    }

    fn version(&self) -> (MapIdentity, u64) {
        (self.reply.map_identity, self.reply.map_version)
    }

    async fn ask(
        client: &CellClient,
        cell: CellId,
        placement: CellPlacement,
        query: &ForwardedQuery,
        deadline: Instant,
    ) -> Result<Self, ClientError> {
        client.localize(cell, placement, query, deadline).await
    }
}

/// The end of an answer, which a decoded one has.
fn status_of(replies: &[MatchReply]) -> Option<&MatchStatus> {
    replies.iter().find_map(|reply| match reply {
        MatchReply::Done(status) => Some(status),
        MatchReply::Keyframe(_) => None,
    })
}

/// The answer of the winner, or what all cells together found out.
fn match_replies(found: Found<CellMatchReply>, received: Instant) -> Vec<MatchReply> {
    let Found { outcome, winner, others } = found;
    let elsewhere: u32 = others
        .iter()
        .filter_map(|reply| status_of(&reply.replies))
        .fold(0, |sum, status| sum.saturating_add(status.searched_keyframes));
    let is_matched = winner.is_some();
    let mut replies =
        winner.or_else(|| others.into_iter().next()).map_or_else(Vec::new, |reply| reply.replies);
    replies.retain(|reply| is_matched || matches!(reply, MatchReply::Done(_)));
    for reply in &mut replies {
        if let MatchReply::Done(status) = reply {
            status.outcome = outcome;
            if !is_matched {
                status.keyframes_sent = 0;
            }
            status.searched_keyframes = status.searched_keyframes.saturating_add(elsewhere);
            status.elapsed_us = received.elapsed().as_micros() as u64;
        }
    }
    replies
}

fn localize_reply(found: Found<CellLocalizeReply>) -> LocalizeReply {
    let Found { outcome, winner, others } = found;
    if let Some(winner) = winner {
        return winner.reply;
    }
    let of_any = others.first().map(|other| (other.reply.map_version, other.reply.map_identity));
    let (map_version, map_identity) = of_any.unwrap_or((0, MapIdentity::from_bytes([0; 16])));
    LocalizeReply { map_version, map_identity, outcome, fix: None }
}

async fn send_keyframe(
    client: &CellClient,
    name: &str,
    query: Query,
    (cell, placement): (CellId, CellPlacement),
    id: KeyframeId,
    asking: &str,
) -> Result<(), ErrorReply> {
    let deadline = Instant::now() + CELL_DEADLINE;
    let reply =
        client.keyframe(cell, placement, id, asking, deadline).await.map_err(|error| match error {
            ClientError::Refused(reply) => reply,
            error => ErrorReply::new(ErrorCode::Busy, format!("cell {cell} of map {name}: {error}")),
        })?;
    let key = keys::map_keyframe(name, id).map_err(|error| handlers::internal(&error))?;
    send_all(query, key, vec![reply]).await
}

/// Sends replies from a thread that may block.
async fn send_all<M: Message + Send + 'static>(
    query: Query,
    key: String,
    messages: Vec<M>,
) -> Result<(), ErrorReply> {
    let sending = tokio::task::spawn_blocking(move || {
        let format = handlers::reply_format(&query).map_err(|error| ErrorReply::from(&error))?;
        messages.iter().try_for_each(|message| handlers::send(&query, &key, format, message).map(drop))
    });
    sending.await.map_err(|error| handlers::internal(&error))?
}
