//! A term of the cost that depends on the states, for example a prior or a measurement between two views.

use nalgebra::DVector;

use crate::bundle::Bundle;
use crate::normal_equations::NormalEquations;

/// A term of the cost besides the pixels of landmarks.
///
/// Its equations are those of its cost: what it adds to the right side is minus the gradient.
pub trait Factor: Sync {
    /// Half the squared residual in standard deviations, or its robust loss.
    ///
    /// # Arguments
    /// * `scale`: of the robust loss (standard deviations), where the factor has one.
    fn cost(&self, bundle: &Bundle, scale: f64) -> f64;

    /// Adds the linearized residual to equations of the states of this bundle.
    ///
    /// # Arguments
    /// * `scale`: of the robust loss (standard deviations); infinite for none.
    fn add_to(&self, equations: &mut NormalEquations, bundle: &Bundle, scale: f64);
}

/// What some terms of the cost say of a change of the states: their information, without robust weights, times the change.
///
/// # Arguments
/// * `change`: of all states of the bundle, in the order of its layout.
pub fn information_times(factors: &[&dyn Factor], bundle: &Bundle, change: &DVector<f64>) -> DVector<f64> {
    let mut equations = NormalEquations::new(bundle.layout());
    for factor in factors {
        factor.add_to(&mut equations, bundle, f64::INFINITY);
    }
    equations.terms_times(change)
}

/// All of them.
impl<F: Factor> Factor for Vec<F> {
    fn cost(&self, bundle: &Bundle, scale: f64) -> f64 {
        self.iter().map(|factor| factor.cost(bundle, scale)).sum()
    }

    fn add_to(&self, equations: &mut NormalEquations, bundle: &Bundle, scale: f64) {
        for factor in self {
            factor.add_to(equations, bundle, scale);
        }
    }
}

/// The factor, where there is one.
impl<F: Factor> Factor for Option<F> {
    fn cost(&self, bundle: &Bundle, scale: f64) -> f64 {
        self.as_ref().map_or(0.0, |factor| factor.cost(bundle, scale))
    }

    fn add_to(&self, equations: &mut NormalEquations, bundle: &Bundle, scale: f64) {
        if let Some(factor) = self {
            factor.add_to(equations, bundle, scale);
        }
    }
}
