//! A query of a robot, from its receipt to the answer of one cell.
//!
//! A worker decodes the query and finds out which cells it could be about; asking these takes no worker, so that servers that ask
//! each other never wait for each other's workers.

use std::collections::BTreeSet;
use std::sync::{Arc, PoisonError, RwLock};
use std::time::{Duration, Instant};

use client::{CellClient, CellPlacement, CellReply, ClientError, ForwardedQuery};
use protocol::{
    CellLocalizeReply, CellMatchReply, CellPlace, ErrorCode, ErrorReply, FeatureSet, KeyframeId,
    LocalizeReply, LocalizeRequest, MapIdentity, MatchOutcome, MatchReply, MatchRequest, MatchStatus,
    Message, PosePrior, PossiblePlace, keys,
};
use recognition::{MAX_HYPOTHESES, PartResult, RecognitionOptions, RecognizedPlace, choose_part};
use releases::CellId;
use tokio::task::JoinSet;
use zenoh::query::Query;

use super::directory::{CellDirectory, CellSearch};
use crate::handlers;
use crate::kind::Kind;

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
    wanted: RoutedRequest,
}

enum RoutedRequest {
    Match(PlannedSearch),
    Localize(PlannedSearch),
    Info,
    Keyframe(KeyframeId),
    AllKeyframes,
}

/// What is needed to find the place of an image.
struct PlannedSearch {
    features: FeatureSet,
    prior: Option<PosePrior>,
    cells: CellSearch,
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
        let search = |features: FeatureSet, prior: Option<PosePrior>| {
            let cells = directory.search(&features, prior.as_ref());
            let cells = cells.map_err(|error| handlers::query_error(&self.name, &error))?;
            Ok::<_, ErrorReply>(PlannedSearch { features, prior, cells })
        };
        let wanted = match kind {
            Kind::Match => {
                let request: MatchRequest = handlers::decode(query)?;
                RoutedRequest::Match(search(request.features, request.prior)?)
            }
            Kind::Localize => {
                let request: LocalizeRequest = handlers::decode(query)?;
                RoutedRequest::Localize(search(request.features, request.prior)?)
            }
            Kind::Info => RoutedRequest::Info,
            Kind::Keyframes => match handlers::asked_keyframe(query)? {
                Some(id) => RoutedRequest::Keyframe(id),
                None => RoutedRequest::AllKeyframes,
            },
        };
        let client = query.parameters().get(keys::CLIENT_PARAMETER).unwrap_or_default().to_owned();
        let payload = query.payload().cloned().unwrap_or_default();
        let encoding = query.encoding().cloned().unwrap_or_default();
        let forwarded = ForwardedQuery { payload, encoding, client };
        Ok(Plan { query: query.clone(), received, forwarded, directory, wanted })
    }

    /// Asks the cells and sends the answer. An error is returned, not yet sent.
    pub(crate) async fn answer(self: Arc<Self>, plan: Plan) -> Result<(), ErrorReply> {
        let Plan { query, received, forwarded, directory, wanted } = plan;
        match wanted {
            RoutedRequest::Match(search) => {
                let found = self.search::<CellMatchReply>(&directory, &forwarded, search).await?;
                let status = directory.status(found.outcome);
                let key = keys::map_match(&self.name).map_err(|error| handlers::internal(&error))?;
                send_all(query, key, match_replies(found, status, received)).await
            }
            RoutedRequest::Localize(search) => {
                let found = self.search::<CellLocalizeReply>(&directory, &forwarded, search).await?;
                let (map_version, map_identity) = (directory.version(), directory.identity());
                let CellReplies { outcome, winner, others } = found;
                let reply = winner.map_or_else(
                    || {
                        let places = likeliest_places(others);
                        LocalizeReply { map_version, map_identity, outcome, fix: None, places }
                    },
                    |winner| winner.reply,
                );
                let key = keys::map_localize(&self.name).map_err(|error| handlers::internal(&error))?;
                send_all(query, key, vec![reply]).await
            }
            RoutedRequest::Info => {
                let key = keys::map_info(&self.name).map_err(|error| handlers::internal(&error))?;
                send_all(query, key, vec![directory.info_reply(&self.name)]).await
            }
            RoutedRequest::Keyframe(id) => {
                let Some(cell) = directory.cell_of(id) else {
                    return Err(handlers::unknown_keyframe(&self.name, id));
                };
                self.send_keyframe(query, cell, id, forwarded.client).await
            }
            RoutedRequest::AllKeyframes => {
                let mut sending = JoinSet::new();
                for (cell, id) in directory.keyframes() {
                    if sending.len() >= KEYFRAMES_AT_ONCE
                        && let Some(sent) = sending.join_next().await
                    {
                        sent.map_err(|error| handlers::internal(&error))??;
                    }
                    let client = forwarded.client.clone();
                    sending.spawn(Arc::clone(&self).send_keyframe(query.clone(), cell, id, client));
                }
                while let Some(sent) = sending.join_next().await {
                    sent.map_err(|error| handlers::internal(&error))??;
                }
                Ok(())
            }
        }
    }

    /// Asks a cell for one of its keyframes, in the name of a client, and sends it.
    async fn send_keyframe(
        self: Arc<Self>,
        query: Query,
        cell: CellId,
        id: KeyframeId,
        client: String,
    ) -> Result<(), ErrorReply> {
        let deadline = Instant::now() + CELL_DEADLINE;
        let asked = self.client.keyframe(cell, self.placement(cell), id, &client, deadline).await;
        let reply = asked.map_err(|error| match error {
            ClientError::Refused(reply) => reply,
            error => self.unanswered(cell, &error),
        })?;
        let key = keys::map_keyframe(&self.name, id).map_err(|error| handlers::internal(&error))?;
        send_all(query, key, vec![reply]).await
    }

    fn unanswered(&self, cell: CellId, error: &ClientError) -> ErrorReply {
        ErrorReply::new(ErrorCode::Busy, format!("cell {cell} of map {}: {error}", self.name))
    }

    /// Asks the first cells, and where none of them shows the place the next ones.
    async fn search<R: PlaceReply>(
        &self,
        directory: &Arc<CellDirectory>,
        forwarded: &ForwardedQuery,
        search: PlannedSearch,
    ) -> Result<CellReplies<R>, ErrorReply> {
        let PlannedSearch { features, prior, cells } = search;
        let asked = CellQuery { directory, forwarded, prior: prior.as_ref() };
        let mut replies: Vec<R> = self.ask(&asked, &cells.first).await?;
        let outcome = match self.choose(&replies) {
            Ok(at) => return Ok(CellReplies::at(replies, at)),
            Err(outcome) => outcome,
        };
        if matches!(outcome, MatchOutcome::Ambiguous | MatchOutcome::TooFewFeatures) {
            return Ok(CellReplies { outcome, winner: None, others: replies });
        }
        let directory = Arc::clone(directory);
        let ranking = tokio::task::spawn_blocking(move || directory.then(&features, cells));
        let then = ranking.await.map_err(|error| handlers::internal(&error))?;
        let then = then.map_err(|error| handlers::query_error(&self.name, &error))?;
        replies.extend(self.ask(&asked, &then).await?);
        Ok(match self.choose(&replies) {
            Ok(at) => CellReplies::at(replies, at),
            Err(outcome) => CellReplies { outcome, winner: None, others: replies },
        })
    }

    fn choose<R: PlaceReply>(&self, replies: &[R]) -> Result<usize, MatchOutcome> {
        let places: Vec<Option<RecognizedPlace>> = replies
            .iter()
            .map(|reply| {
                let CellPlace { global_from_camera, features } = reply.place()?;
                Some(RecognizedPlace::new(*global_from_camera, *features as usize))
            })
            .collect();
        let results = replies.iter().zip(&places);
        let results: Vec<PartResult<'_>> = results
            .map(|(reply, place)| {
                let (outcome, log_odds) = (reply.outcome(), reply.log_odds());
                PartResult { outcome, place: place.as_ref(), log_odds }
            })
            .collect();
        choose_part(&results, &self.options)
    }

    /// Whether the place that replies show is one that a prior supports.
    fn is_supported<R: PlaceReply>(&self, prior: Option<&PosePrior>, replies: &[R]) -> bool {
        let chosen = self.choose(replies).ok().and_then(|at| replies[at].place());
        let both = prior.zip(chosen);
        both.is_some_and(|(prior, place)| {
            recognition::is_supported(&place.global_from_camera, &prior.global_from_camera)
        })
    }

    /// The replies of cells. Where a cell does not answer there is no answer, since it could be of that cell; only near a prior
    /// those of the others will do, if one of them shows a place that the prior supports.
    async fn ask<R: PlaceReply>(
        &self,
        asked: &CellQuery<'_>,
        cells: &[CellId],
    ) -> Result<Vec<R>, ErrorReply> {
        let deadline = Instant::now() + CELL_DEADLINE;
        let version = (asked.directory.identity(), asked.directory.version());
        let mut asking = JoinSet::new();
        for (at, &cell) in cells.iter().enumerate() {
            let (client, placement, forwarded) =
                (self.client.clone(), self.placement(cell), asked.forwarded.clone());
            asking
                .spawn(async move { (at, client.forward::<R>(cell, placement, &forwarded, deadline).await) });
        }
        let mut replies: Vec<Option<R>> = cells.iter().map(|_| None).collect();
        let mut failure = None;
        while let Some(joined) = asking.join_next().await {
            let (at, reply) = joined.map_err(|error| handlers::internal(&error))?;
            match reply {
                Ok(reply) if reply.version() == Some(version) => {
                    replies[at] = Some(reply);
                }
                Ok(_) => {
                    let message = format!("map {} is changing over to another version, ask again", self.name);
                    failure = Some(ErrorReply::new(ErrorCode::Busy, message));
                }
                Err(ClientError::Refused(reply)) if reply.code != ErrorCode::Busy => return Err(reply),
                Err(error) => failure = Some(self.unanswered(cells[at], &error)),
            }
        }
        let replies: Vec<R> = replies.into_iter().flatten().collect();
        match failure {
            Some(failure) if !self.is_supported(asked.prior, &replies) => Err(failure),
            _ => Ok(replies),
        }
    }
}

/// A query on its way to cells.
struct CellQuery<'a> {
    directory: &'a CellDirectory,
    forwarded: &'a ForwardedQuery,
    prior: Option<&'a PosePrior>,
}

/// What the cells found.
struct CellReplies<R> {
    outcome: MatchOutcome,
    winner: Option<R>,
    others: Vec<R>,
}

impl<R> CellReplies<R> {
    fn at(mut replies: Vec<R>, at: usize) -> Self {
        let winner = Some(replies.swap_remove(at));
        Self { outcome: MatchOutcome::Matched, winner, others: replies }
    }
}

/// The answer of a cell about a place.
trait PlaceReply: CellReply + Send + 'static {
    fn outcome(&self) -> MatchOutcome;
    fn place(&self) -> Option<&CellPlace>;
    /// Natural logarithm of the odds of its place; zero without one.
    fn log_odds(&self) -> f64;
    /// Of the map; `None` for an answer without an end.
    fn version(&self) -> Option<(MapIdentity, u64)>;
}

impl PlaceReply for CellMatchReply {
    fn outcome(&self) -> MatchOutcome {
        status_of(&self.replies).map_or(MatchOutcome::NoMatch, |status| status.outcome)
    }

    fn place(&self) -> Option<&CellPlace> {
        self.place.as_ref()
    }

    fn log_odds(&self) -> f64 {
        status_of(&self.replies).map_or(0.0, |status| status.log_odds)
    }

    fn version(&self) -> Option<(MapIdentity, u64)> {
        status_of(&self.replies).map(|status| (status.map_identity, status.map_version))
    }
}

impl PlaceReply for CellLocalizeReply {
    fn outcome(&self) -> MatchOutcome {
        self.reply.outcome
    }

    fn place(&self) -> Option<&CellPlace> {
        self.place.as_ref()
    }

    fn log_odds(&self) -> f64 {
        self.reply.places.first().map_or(0.0, |place| place.log_odds)
    }

    fn version(&self) -> Option<(MapIdentity, u64)> {
        Some((self.reply.map_identity, self.reply.map_version))
    }
}

/// The end of an answer, which a decoded one has.
fn status_of(replies: &[MatchReply]) -> Option<&MatchStatus> {
    replies.iter().find_map(|reply| match reply {
        MatchReply::Done(status) => Some(status),
        MatchReply::Keyframe(_) => None,
    })
}

/// The places that an image could be of according to all cells, the likeliest first, at most as many as one map lists.
fn likeliest_places(replies: Vec<CellLocalizeReply>) -> Vec<PossiblePlace> {
    let mut places: Vec<PossiblePlace> = replies.into_iter().flat_map(|reply| reply.reply.places).collect();
    places.sort_by(|a, b| b.log_odds.total_cmp(&a.log_odds));
    places.truncate(MAX_HYPOTHESES);
    places
}

/// The keyframes of the winner, if there is one, and an end for all cells together.
fn match_replies(
    found: CellReplies<CellMatchReply>,
    mut status: MatchStatus,
    received: Instant,
) -> Vec<MatchReply> {
    let CellReplies { winner, others, .. } = found;
    let searched = winner.iter().chain(&others).filter_map(|reply| status_of(&reply.replies));
    status.searched_keyframes = searched.fold(0, |sum, status| sum.saturating_add(status.searched_keyframes));
    if let Some(winner) = winner.as_ref().and_then(|winner| status_of(&winner.replies)) {
        (status.log_odds, status.log_prior_odds) = (winner.log_odds, winner.log_prior_odds);
    }
    let mut replies = winner.map_or_else(Vec::new, |winner| winner.replies);
    replies.retain(|reply| matches!(reply, MatchReply::Keyframe(_)));
    status.keyframes_sent = replies.len() as u16;
    status.elapsed_us = received.elapsed().as_micros() as u64;
    replies.push(MatchReply::Done(status));
    replies
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
