//! The joint covariance of all poses after an adjustment in which the tied keyframes of stored maps took part.

use adjustment::{POSE, StateCovariance, StateLayout, parallel, pose_error};
use geometry::pose::Pose;
use nalgebra::{DMatrix, DVector, Matrix6, Vector6};

use super::{Dependence, StoredPoses};

/// The covariance of the errors `[δθ, δp]` in G of some views, column by column.
pub(crate) struct Posterior<'a> {
    covariance: &'a StateCovariance,
    /// The views that are wanted.
    wanted: Vec<RequestedPose>,
    /// Those of them that were adjusted.
    adjusted: Vec<usize>,
    maps: Vec<AdjustedMap<'a>>,
    /// Of the wanted views, those that are keyframes of a map which stays as it is: the map and its keyframe.
    considered: Vec<Option<(usize, usize)>>,
}

/// Where the covariance of a view comes from.
#[derive(Clone, Copy)]
enum RequestedPose {
    /// The adjustment, where it is the view at this position among those that are adjusted.
    Adjusted(usize),
    /// The keyframes of its map that were adjusted.
    Following { map: usize, keyframe: usize },
}

/// A stored map after the adjustment.
struct AdjustedMap<'a> {
    stored: &'a StoredPoses,
    /// Jacobian of the error of each keyframe relative to its stored pose, by the error of its adjusted pose.
    jacobians: Vec<Matrix6<f64>>,
    /// Where the tied keyframes are among the adjusted views.
    tied: Vec<usize>,
    /// Covariance of all adjusted views (rows) with the tied keyframes; without columns where no keyframe follows.
    with_tied: DMatrix<f64>,
}

impl<'a> Posterior<'a> {
    /// # Arguments
    /// * `covariance`: of all states at the minimum.
    /// * `poses`: of all views, at the minimum.
    /// * `views`: those whose covariance is wanted, with all tied keyframes, in order.
    pub(crate) fn new(
        covariance: &'a StateCovariance,
        poses: &[Pose],
        views: &[usize],
        stored: &'a [StoredPoses],
    ) -> Posterior<'a> {
        let mut adjusted = Vec::new();
        let mut wanted = Vec::with_capacity(views.len());
        for &view in views {
            let following = stored.iter().enumerate().find_map(|(map, of_map)| {
                let keyframe = view.checked_sub(of_map.first)?;
                of_map.follows.get(keyframe)?.then_some(RequestedPose::Following { map, keyframe })
            });
            wanted.push(following.unwrap_or(RequestedPose::Adjusted(adjusted.len())));
            if following.is_none() {
                adjusted.push(view);
            }
        }
        let considered = |view: &usize| {
            stored.iter().enumerate().filter(|(_, of_map)| of_map.is_considered).find_map(|(map, of_map)| {
                let keyframe = view.checked_sub(of_map.first)?;
                (keyframe < of_map.means.len()).then_some((map, keyframe))
            })
        };
        let considered = views.iter().map(considered).collect();
        let mut posterior = Posterior { covariance, wanted, adjusted, maps: Vec::new(), considered };
        posterior.maps = stored.iter().map(|of_map| posterior.adjusted_map(of_map, poses)).collect();
        posterior
    }

    fn adjusted_map(&self, stored: &'a StoredPoses, poses: &[Pose]) -> AdjustedMap<'a> {
        let means = stored.means.iter().zip(&poses[stored.first..]);
        let jacobians = means.map(|(mean, pose)| pose_error(mean, pose).1).collect();
        let views: Vec<usize> = stored.tied_views().collect();
        let tied = views.iter().map(|view| self.adjusted.partition_point(|other| other < view)).collect();
        let columns = if stored.tied.len() < stored.means.len() { views.len() } else { 0 };
        let mut with_tied = DMatrix::zeros(POSE * self.adjusted.len(), POSE * columns);
        let mut next = 0;
        let column = |at: usize| self.adjusted_column(views[at]);
        parallel::for_each(columns, column, |column| {
            with_tied.columns_mut(next, POSE).copy_from(&column);
            next += POSE;
        });
        AdjustedMap { stored, jacobians, tied, with_tied }
    }

    /// The column of an adjusted view, with the rows of those that are adjusted and wanted.
    fn adjusted_column(&self, view: usize) -> DMatrix<f64> {
        let blocks = self.covariance.blocks(self.adjusted.iter().copied(), view);
        let mut column = DMatrix::zeros(POSE * self.adjusted.len(), POSE);
        for (at, block) in blocks.iter().enumerate() {
            column.fixed_rows_mut::<POSE>(POSE * at).copy_from(block);
        }
        column
    }

    /// The same for the view at this position among those that are adjusted.
    fn known_or_computed_column(&self, position: usize) -> DMatrix<f64> {
        let known = self.maps.iter().filter(|map| !map.with_tied.is_empty()).find_map(|map| {
            let at = map.tied.binary_search(&position).ok()?;
            Some(map.with_tied.columns(POSE * at, POSE).into_owned())
        });
        known.unwrap_or_else(|| self.adjusted_column(self.adjusted[position]))
    }

    /// The column of the wanted view at this position: a block for each wanted view.
    pub(crate) fn column(&self, at: usize) -> Vec<Matrix6<f64>> {
        let mut column = self.adjusted_map_column(at);
        let own = self.considered[at];
        let stated = own.map(|(map, keyframe)| self.maps[map].stored.covariance.column(keyframe));
        for (block, row) in column.iter_mut().zip(&self.considered) {
            match (row, own, &stated) {
                (Some((map, keyframe)), Some((of_own, _)), Some(stated)) if *map == of_own => {
                    *block = stated.fixed_view::<POSE, POSE>(POSE * keyframe, 0).into();
                }
                _ => {
                    // The errors are those of the stored poses, not of the adjusted ones.
                    if let Some((map, keyframe)) = row {
                        *block = self.maps[*map].jacobians[*keyframe] * *block;
                    }
                    if let Some((map, keyframe)) = own {
                        *block *= self.maps[map].jacobians[keyframe].transpose();
                    }
                }
            }
        }
        column
    }

    /// The same where the poses of all maps are adjusted.
    fn adjusted_map_column(&self, at: usize) -> Vec<Matrix6<f64>> {
        let (adjusted, own) = match self.wanted[at] {
            RequestedPose::Adjusted(position) => (self.known_or_computed_column(position), None),
            RequestedPose::Following { map, keyframe } => {
                let of_map = &self.maps[map];
                let dependence = of_map.stored.dependence(keyframe);
                let mut gain = of_map.stored.total_gain(&dependence);
                of_map.multiply_by_jacobians(&mut gain, Matrix6::transpose);
                (&of_map.with_tied * gain, Some((map, keyframe, dependence)))
            }
        };
        let following =
            self.following(&adjusted, own.as_ref().map(|(map, _, dependence)| (*map, dependence)));
        let by_column =
            own.as_ref().map(|(map, keyframe, _)| self.maps[*map].inverse_jacobian(*keyframe).transpose());
        let block = |wanted: &RequestedPose| -> Matrix6<f64> {
            let block: Matrix6<f64> = match *wanted {
                RequestedPose::Adjusted(position) => {
                    adjusted.fixed_view::<POSE, POSE>(POSE * position, 0).into()
                }
                RequestedPose::Following { map, keyframe } => {
                    let rows = following[map].fixed_view::<POSE, POSE>(POSE * keyframe, 0);
                    self.maps[map].inverse_jacobian(keyframe) * rows
                }
            };
            by_column.map_or(block, |by_column| block * by_column)
        };
        self.wanted.iter().map(block).collect()
    }

    /// Rows of the keyframes of each map that follow, given those of the adjusted views: errors relative to the stored poses.
    ///
    /// # Arguments
    /// * `own`: map and dependence of the keyframe whose column this is, where it follows.
    fn following(&self, adjusted: &DMatrix<f64>, own: Option<(usize, &Dependence)>) -> Vec<DMatrix<f64>> {
        let of_map = |(map, of_map): (usize, &AdjustedMap<'_>)| {
            if of_map.with_tied.is_empty() {
                return DMatrix::zeros(0, 0);
            }
            let mut of_tied = super::rows_of(adjusted, &of_map.tied);
            of_map.multiply_by_jacobians(&mut of_tied, Matrix6::clone_owned);
            let own = own.filter(|(of_own, _)| *of_own == map).map(|(_, dependence)| dependence);
            of_map.stored.propagated(&of_tied, own)
        };
        self.maps.iter().enumerate().map(of_map).collect()
    }

    /// How far the wanted views move where the states do: the keyframes that follow as far as those of their map that were adjusted say,
    /// those of a map that stays as it is not at all.
    ///
    /// # Arguments
    /// * `states`: changes of all states, in the order of the layout.
    pub(crate) fn moved(&self, states: &DVector<f64>, layout: StateLayout) -> Vec<Vector6<f64>> {
        let mut adjusted = DMatrix::zeros(POSE * self.adjusted.len(), 1);
        for (at, &view) in self.adjusted.iter().enumerate() {
            let of_view = states.fixed_rows::<POSE>(layout.pose(view).start);
            adjusted.fixed_view_mut::<POSE, 1>(POSE * at, 0).copy_from(&of_view);
        }
        let following = self.following(&adjusted, None);
        let moved = |(wanted, considered): (&RequestedPose, &Option<(usize, usize)>)| -> Vector6<f64> {
            match *wanted {
                _ if considered.is_some() => Vector6::zeros(),
                RequestedPose::Adjusted(position) => {
                    adjusted.fixed_view::<POSE, 1>(POSE * position, 0).into_owned()
                }
                RequestedPose::Following { map, keyframe } => {
                    let of_keyframe = following[map].fixed_view::<POSE, 1>(POSE * keyframe, 0);
                    self.maps[map].inverse_jacobian(keyframe) * of_keyframe
                }
            }
        };
        self.wanted.iter().zip(&self.considered).map(moved).collect()
    }
}

impl AdjustedMap<'_> {
    /// Multiplies the rows of each tied keyframe by its Jacobian, or what `of_jacobian` makes of it.
    fn multiply_by_jacobians(
        &self,
        rows: &mut DMatrix<f64>,
        of_jacobian: impl Fn(&Matrix6<f64>) -> Matrix6<f64>,
    ) {
        for (at, &keyframe) in self.stored.tied.iter().enumerate() {
            let product = of_jacobian(&self.jacobians[keyframe]) * rows.fixed_rows::<POSE>(POSE * at);
            rows.fixed_rows_mut::<POSE>(POSE * at).copy_from(&product);
        }
    }

    /// The inverse of the Jacobian of a keyframe: of the error of its adjusted pose by that of its stored pose.
    fn inverse_jacobian(&self, keyframe: usize) -> Matrix6<f64> {
        // The inverse of the left Jacobian, which is invertible within half a turn.
        self.jacobians[keyframe].try_inverse().unwrap_or_else(Matrix6::identity)
    }
}
