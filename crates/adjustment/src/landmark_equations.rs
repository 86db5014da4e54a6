//! The equations of a run of landmarks, each eliminated when it is added (`normal_equations` has the formulas).

use nalgebra::{DVector, Matrix3, Matrix6, Matrix6x3, Vector3, Vector6};

use crate::layout::StateLayout;

/// No block yet, in the table of blocks.
const NONE: u32 = u32::MAX;

/// A landmark whose V has a smaller reciprocal condition number, with its diagonal scaled to one, is not determined: what is left of its
/// inverse is rounding.
const LEAST_RECIPROCAL_CONDITION: f64 = 1e-12;

/// The blocks of one landmark: all that its pixels, and what a map knows of it, say.
#[derive(Default)]
pub struct LandmarkBlocks {
    /// What they add to the diagonal of H and to g: view, `J_view^T J_view`, `J_view^T r`.
    pub poses: Vec<(usize, Matrix6<f64>, Vector6<f64>)>,
    /// What they add beside the diagonal of H: two views a and b, `J_a^T J_b`.
    pub pairs: Vec<(usize, usize, Matrix6<f64>)>,
    /// Blocks of W: view, `J_view^T J_point`.
    pub couplings: Vec<(usize, Matrix6x3<f64>)>,
    /// V.
    pub information: Matrix3<f64>,
    /// l.
    pub gradient: Vector3<f64>,
}

impl LandmarkBlocks {
    /// Makes all of them zero, and keeps the memory.
    pub fn clear(&mut self) {
        self.poses.clear();
        self.pairs.clear();
        self.couplings.clear();
        self.information = Matrix3::zeros();
        self.gradient = Vector3::zeros();
    }
}

/// A landmark after its elimination.
struct Eliminated {
    /// The inverse of V; zero for a landmark that is not determined.
    inverse: Matrix3<f64>,
    /// l.
    gradient: Vector3<f64>,
    /// End of its couplings.
    end: usize,
}

/// Landmarks that were eliminated: what gives their errors once those of the poses are known.
pub(crate) struct EliminatedLandmarks {
    /// The views that observe them, in order.
    views: Vec<usize>,
    landmarks: Vec<Eliminated>,
    /// Blocks of W of all landmarks, by position in `views`.
    couplings: Vec<(usize, Matrix6x3<f64>)>,
}

/// The equations of a run of landmarks and the poses that observe them.
pub struct LandmarkEquations {
    /// The landmarks so far, and all views.
    eliminated: EliminatedLandmarks,
    /// Diagonal blocks of H, in the order of the views.
    diagonal: Vec<Matrix6<f64>>,
    /// Blocks of g.
    gradient: Vec<Vector6<f64>>,
    /// Blocks of `W V^-1 l`.
    eliminated_gradient: Vec<Vector6<f64>>,
    /// Where the block of two views is in `blocks`, [`NONE`] before it is; the smaller one is the row.
    table: Vec<u32>,
    /// Blocks (a, b), `a <= b`, of `H - W V^-1 W^T` without the diagonal of H.
    blocks: Vec<(usize, usize, Matrix6<f64>)>,
}

impl LandmarkEquations {
    /// Equations without landmarks.
    ///
    /// # Arguments
    /// * `views`: all that the landmarks to come are seen from, in any order.
    pub fn new(views: impl Iterator<Item = usize>) -> LandmarkEquations {
        let mut views: Vec<usize> = views.collect();
        views.sort_unstable();
        views.dedup();
        let count = views.len();
        LandmarkEquations {
            eliminated: EliminatedLandmarks { views, landmarks: Vec::new(), couplings: Vec::new() },
            diagonal: vec![Matrix6::zeros(); count],
            gradient: vec![Vector6::zeros(); count],
            eliminated_gradient: vec![Vector6::zeros(); count],
            table: vec![NONE; count * count],
            blocks: Vec::new(),
        }
    }

    /// Adds information on one pose.
    fn add_pose(&mut self, view: usize, information: &Matrix6<f64>, gradient: &Vector6<f64>) {
        let at = self.position(view);
        self.diagonal[at] += information;
        self.gradient[at] += gradient;
    }

    /// Adds the block `J_a^T J_b` of two views.
    fn add_pair(&mut self, a: usize, b: usize, block: &Matrix6<f64>) {
        let (a, b) = (self.position(a), self.position(b));
        if a <= b {
            *self.block(a, b) += block;
        } else {
            *self.block(b, a) += block.transpose();
        }
    }

    /// Adds a landmark and eliminates it. One whose V is singular, or so nearly that its inverse is rounding, is held constant and says
    /// nothing of the poses: its pixels would measure them as if it were known exactly.
    pub fn add_landmark(&mut self, landmark: &LandmarkBlocks) {
        let begin = self.eliminated.couplings.len();
        let Some(inverse) = inverse_of_determined(&landmark.information) else {
            let held = Eliminated { inverse: Matrix3::zeros(), gradient: landmark.gradient, end: begin };
            self.eliminated.landmarks.push(held);
            return;
        };
        for (view, information, gradient) in &landmark.poses {
            self.add_pose(*view, information, gradient);
        }
        for (a, b, block) in &landmark.pairs {
            self.add_pair(*a, *b, block);
        }
        for (view, coupling) in &landmark.couplings {
            let at = self.position(*view);
            let couplings = &mut self.eliminated.couplings;
            match couplings[begin..].iter_mut().find(|(known, _)| *known == at) {
                Some((_, sum)) => *sum += coupling,
                None => couplings.push((at, *coupling)),
            }
        }
        self.eliminated.couplings[begin..].sort_unstable_by_key(|(at, _)| *at);
        let end = self.eliminated.couplings.len();
        for index in begin..end {
            let (a, by_a) = self.eliminated.couplings[index];
            let eliminated = by_a * inverse;
            self.eliminated_gradient[a] += eliminated * landmark.gradient;
            for other in index..end {
                let (b, by_b) = self.eliminated.couplings[other];
                *self.block(a, b) -= eliminated * by_b.transpose();
            }
        }
        self.eliminated.landmarks.push(Eliminated { inverse, gradient: landmark.gradient, end });
    }

    /// The blocks (a, b) of S, `a <= b`, without the diagonal of H.
    pub(crate) fn blocks(&self) -> impl Iterator<Item = ((usize, usize), &Matrix6<f64>)> {
        let views = &self.eliminated.views;
        self.blocks.iter().map(|(a, b, block)| ((views[*a], views[*b]), block))
    }

    /// The view, its block of the diagonal of H, and its blocks of g and `W V^-1 l`.
    pub(crate) fn of_views(
        &self,
    ) -> impl Iterator<Item = (usize, &Matrix6<f64>, &Vector6<f64>, &Vector6<f64>)> {
        let gradients = self.gradient.iter().zip(&self.eliminated_gradient);
        let of_views = self.eliminated.views.iter().zip(&self.diagonal).zip(gradients);
        of_views.map(|((view, diagonal), (gradient, eliminated))| (*view, diagonal, gradient, eliminated))
    }

    /// The landmarks, without the equations of the poses.
    pub(crate) fn into_landmarks(self) -> EliminatedLandmarks {
        self.eliminated
    }

    /// Position of a view.
    fn position(&self, view: usize) -> usize {
        self.eliminated.views.partition_point(|&known| known < view)
    }

    /// The block of two positions, `a <= b`.
    fn block(&mut self, a: usize, b: usize) -> &mut Matrix6<f64> {
        let at = &mut self.table[a * self.eliminated.views.len() + b];
        if *at == NONE {
            *at = self.blocks.len() as u32;
            self.blocks.push((a, b, Matrix6::zeros()));
        }
        &mut self.blocks[*at as usize].2
    }
}

/// The inverse of V; `None` where V is singular but for rounding. Ray and depth have other units, so that its diagonal is scaled to one
/// before.
fn inverse_of_determined(information: &Matrix3<f64>) -> Option<Matrix3<f64>> {
    let scale = information.diagonal().map(|value| value.sqrt().recip());
    let scale = scale * scale.transpose();
    let scaled = information.component_mul(&scale);
    let inverse = scaled.try_inverse()?;
    // NaN, of a diagonal with a zero, is not above.
    let reciprocal_condition = (scaled.norm() * inverse.norm()).recip();
    (reciprocal_condition > LEAST_RECIPROCAL_CONDITION).then(|| inverse.component_mul(&scale))
}

impl EliminatedLandmarks {
    /// The errors `[ray, inverse depth]` of the landmarks, given those of the states.
    pub(crate) fn errors(&self, layout: StateLayout, states: &DVector<f64>) -> Vec<Vector3<f64>> {
        let of_view = |view: &usize| states.fixed_rows::<6>(layout.pose(*view).start).into_owned();
        let errors: Vec<Vector6<f64>> = self.views.iter().map(of_view).collect();
        let mut begin = 0;
        let solved = |landmark: &Eliminated| {
            let couplings = &self.couplings[begin..landmark.end];
            begin = landmark.end;
            let known = couplings
                .iter()
                .fold(Vector3::zeros(), |sum, (at, by_pose)| sum + by_pose.tr_mul(&errors[*at]));
            landmark.inverse * (landmark.gradient - known)
        };
        self.landmarks.iter().map(solved).collect()
    }
}
