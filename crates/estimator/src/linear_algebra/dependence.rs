//! Errors that grow by a multiple of others, `T = I + J` with a few small blocks `J`.

use super::dense::Dense;
use nalgebra::{SMatrix, SVector, SVectorView};

/// The errors from `begin` on grow by `jacobian` times those from `of` on.
///
/// Of several that are applied together, none may change what another one, or itself, depends on.
#[derive(Clone, Copy, Debug)]
pub struct Dependence<const R: usize, const C: usize> {
    /// First of `R` errors that change.
    pub begin: usize,
    /// First of `C` errors that they depend on.
    pub of: usize,
    /// `R` x `C`.
    pub jacobian: SMatrix<f64, R, C>,
}

impl Dense {
    /// `← T self`: rows change.
    pub fn add_to_rows<const R: usize, const C: usize>(&mut self, dependences: &[Dependence<R, C>]) {
        for column in 0..self.ncols() {
            let own = self.column_mut(column);
            for Dependence { begin, of, jacobian } in dependences {
                let added: SVector<f64, R> = jacobian * SVectorView::<f64, C>::from_slice(&own[*of..]);
                own[*begin..].iter_mut().zip(&added).for_each(|(target, added)| *target += added);
            }
        }
    }

    /// `← self Tᵀ`: columns change.
    pub fn add_to_columns<const R: usize, const C: usize>(&mut self, dependences: &[Dependence<R, C>]) {
        for Dependence { begin, of, jacobian } in dependences {
            for (c, factors) in jacobian.column_iter().enumerate() {
                for (r, factor) in factors.iter().enumerate().filter(|(_, factor)| **factor != 0.0) {
                    let (source, target) = self.column_and_mut(of + c, begin + r);
                    target.iter_mut().zip(source).for_each(|(target, source)| *target += factor * source);
                }
            }
        }
    }
}
