//! EPnP: the pose from six or more points in linear time.
//!
//! Every point is a weighted sum of four control points. In the camera frame the twelve coordinates of these solve a
//! homogeneous linear system; they are a combination of its four smallest right singular vectors, with factors that keep
//! the six distances between the control points.
//!
//! Source: Lepetit, Moreno-Noguer & Fua, "EPnP: an accurate O(n) solution to the PnP problem", IJCV 2009.

use super::PnpError;
use super::align::{align_points, mean};
use crate::pose::Pose;
use nalgebra::{
    DMatrix, DVector, Matrix3, Matrix4, SMatrix, SVector, SymmetricEigen, Vector2, Vector3, Vector4,
};

/// With fewer points the linear system has several null vectors; use P3P.
const MIN_POINTS: usize = 6;
/// Ratio of the smallest to the largest standard deviation along the principal axes below which points are coplanar.
const PLANAR: f64 = 1e-3;
/// Gauss-Newton steps on the four factors.
const BETA_STEPS: usize = 15;
/// Pairs of control points.
const PAIRS: [(usize, usize); 6] = [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)];
/// The products of factors that each initial guess solves for, with all others zero.
const GUESSES: [&[(usize, usize)]; 4] = [
    &[(0, 0)],
    &[(0, 0), (0, 1), (1, 1)],
    &[(0, 0), (0, 1), (1, 1), (0, 2), (1, 2)],
    &[(0, 0), (0, 1), (0, 2), (0, 3)],
];

/// The pose `world_from_camera` from n >= 6 points that do not lie in a plane.
///
/// # Arguments
/// * `points`: n points in the world frame, metres.
/// * `normalized`: n undistorted normalized coordinates, see [`crate::Camera::unproject`].
///
/// # Errors
/// [`PnpError::TooFew`] below six points, [`PnpError::Degenerate`] if they are (nearly) coplanar or collinear,
/// [`PnpError::NoSolution`] if no candidate has the points in front of the camera, [`PnpError::LengthMismatch`],
/// [`PnpError::InvalidInput`].
pub fn epnp(points: &[Vector3<f64>], normalized: &[Vector2<f64>]) -> Result<Pose, PnpError> {
    check_input(points, normalized)?;
    let controls = control_points(points)?;
    let weights = barycentric_weights(points, &controls)?;
    let basis = null_basis(&weights, normalized)?;
    let distances =
        SVector::<f64, 6>::from_iterator(PAIRS.map(|(a, b)| (controls[a] - controls[b]).norm_squared()));
    let products = difference_products(&basis);

    let mut best: Option<(f64, Pose)> = None;
    for guess in GUESSES {
        let Some(start) = initial_betas(&products, &distances, guess) else { continue };
        let betas = improve_betas(&products, &distances, start);
        let Ok(pose) = pose_of_betas(points, &weights, &basis, &betas) else { continue };
        let error = total_error(points, normalized, &pose);
        if error.is_finite() && best.as_ref().is_none_or(|(least, _)| error < *least) {
            best = Some((error, pose));
        }
    }
    best.map(|(_, pose)| pose).ok_or(PnpError::NoSolution)
}

fn check_input(points: &[Vector3<f64>], normalized: &[Vector2<f64>]) -> Result<(), PnpError> {
    if points.len() != normalized.len() {
        return Err(PnpError::LengthMismatch { points: points.len(), rays: normalized.len() });
    }
    if points.len() < MIN_POINTS {
        return Err(PnpError::TooFew { given: points.len(), needed: MIN_POINTS });
    }
    let finite = points.iter().flat_map(|p| p.iter()).chain(normalized.iter().flat_map(|n| n.iter()));
    if finite.clone().all(|value| value.is_finite()) { Ok(()) } else { Err(PnpError::InvalidInput) }
}

/// The centroid, and one point per principal axis at one standard deviation.
fn control_points(points: &[Vector3<f64>]) -> Result<[Vector3<f64>; 4], PnpError> {
    let centre = mean(points);
    let scatter: Matrix3<f64> = points.iter().map(|p| (p - centre) * (p - centre).transpose()).sum();
    let eigen = SymmetricEigen::new(scatter / points.len() as f64);
    let deviations = eigen.eigenvalues.map(|variance| variance.max(0.0).sqrt());
    let largest = deviations.max();
    if largest <= 0.0 || deviations.min() <= PLANAR * largest {
        return Err(PnpError::Degenerate);
    }
    let axis = |i: usize| centre + eigen.eigenvectors.column(i) * deviations[i];
    Ok([centre, axis(0), axis(1), axis(2)])
}

/// The weights (sum one) of the control points for every point.
fn barycentric_weights(
    points: &[Vector3<f64>],
    controls: &[Vector3<f64>; 4],
) -> Result<Vec<Vector4<f64>>, PnpError> {
    let [c, x, y, z] = controls;
    let inverse = Matrix3::from_columns(&[x - c, y - c, z - c]).try_inverse().ok_or(PnpError::Degenerate)?;
    Ok(points
        .iter()
        .map(|point| {
            let w = inverse * (point - c);
            Vector4::new(1.0 - w.sum(), w.x, w.y, w.z)
        })
        .collect())
}

/// The four right singular vectors (12x4) of the smallest singular values, smallest first.
fn null_basis(
    weights: &[Vector4<f64>],
    normalized: &[Vector2<f64>],
) -> Result<SMatrix<f64, 12, 4>, PnpError> {
    let mut system = DMatrix::zeros(2 * weights.len(), 12);
    for (i, (w, n)) in weights.iter().zip(normalized).enumerate() {
        for j in 0..4 {
            system[(2 * i, 3 * j)] = w[j];
            system[(2 * i, 3 * j + 2)] = -n.x * w[j];
            system[(2 * i + 1, 3 * j + 1)] = w[j];
            system[(2 * i + 1, 3 * j + 2)] = -n.y * w[j];
        }
    }
    // The triangle of a QR has the same right singular vectors and none of the squared condition of M^T M.
    let triangle = system.qr().unpack_r();
    let svd = triangle.svd(false, true);
    let v_t = svd.v_t.ok_or(PnpError::Degenerate)?;
    let mut order: Vec<usize> = (0..v_t.nrows()).collect();
    order.sort_by(|&a, &b| svd.singular_values[a].total_cmp(&svd.singular_values[b]));
    let mut basis = SMatrix::<f64, 12, 4>::zeros();
    for (column, &row) in order.iter().take(4).enumerate() {
        basis.set_column(column, &v_t.row(row).transpose().fixed_rows::<12>(0));
    }
    Ok(basis)
}

/// For each pair of control points, the products of the differences of the basis vectors: the squared distance is
/// `betas^T products betas`.
fn difference_products(basis: &SMatrix<f64, 12, 4>) -> [Matrix4<f64>; 6] {
    PAIRS.map(|(a, b)| {
        let differences = basis.fixed_rows::<3>(3 * a) - basis.fixed_rows::<3>(3 * b);
        differences.tr_mul(&differences)
    })
}

/// The factors from a linear solution for some of their products.
fn initial_betas(
    products: &[Matrix4<f64>; 6],
    distances: &SVector<f64, 6>,
    unknowns: &[(usize, usize)],
) -> Option<Vector4<f64>> {
    let system = DMatrix::from_fn(6, unknowns.len(), |pair, column| {
        let (k, l) = unknowns[column];
        products[pair][(k, l)] * if k == l { 1.0 } else { 2.0 }
    });
    let right = DVector::from_column_slice(distances.as_slice());
    let solution = system.svd(true, true).solve(&right, 1e-14).ok()?;
    let b11 = solution[0].abs().sqrt();
    if b11 <= 0.0 {
        return None;
    }
    let mut betas = Vector4::new(b11, 0.0, 0.0, 0.0);
    for (value, &(k, l)) in solution.iter().zip(unknowns) {
        if k == 0 && l > 0 {
            betas[l] = value / b11 * solution[0].signum();
        }
    }
    betas.iter().all(|value| value.is_finite()).then_some(betas)
}

/// Gauss-Newton, lightly damped, on the six distances.
fn improve_betas(
    products: &[Matrix4<f64>; 6],
    distances: &SVector<f64, 6>,
    mut betas: Vector4<f64>,
) -> Vector4<f64> {
    let residual_at = |b: &Vector4<f64>| {
        SVector::<f64, 6>::from_fn(|pair, _| distances[pair] - b.dot(&(products[pair] * b)))
    };
    let mut residual = residual_at(&betas);
    let mut damping = 1e-9;
    for _ in 0..BETA_STEPS {
        let jacobian =
            SMatrix::<f64, 6, 4>::from_fn(|pair, k| 2.0 * products[pair].row(k).transpose().dot(&betas));
        let normal = jacobian.tr_mul(&jacobian);
        let damped = normal + Matrix4::identity() * (damping * normal.trace());
        let Some(step) = damped.cholesky().map(|factor| factor.solve(&jacobian.tr_mul(&residual))) else {
            break;
        };
        let candidate = betas + step;
        let candidate_residual = residual_at(&candidate);
        if candidate_residual.norm_squared() < residual.norm_squared() {
            (betas, residual) = (candidate, candidate_residual);
            damping = (damping * 0.1).max(1e-15);
        } else {
            damping = (damping * 100.0).max(1e-6);
        }
    }
    betas
}

fn pose_of_betas(
    points: &[Vector3<f64>],
    weights: &[Vector4<f64>],
    basis: &SMatrix<f64, 12, 4>,
    betas: &Vector4<f64>,
) -> Result<Pose, PnpError> {
    let controls = basis * betas;
    let mut in_camera: Vec<Vector3<f64>> = weights
        .iter()
        .map(|w| (0..4).map(|j| controls.fixed_rows::<3>(3 * j) * w[j]).sum::<Vector3<f64>>())
        .collect();
    if in_camera.iter().map(|p| p.z).sum::<f64>() < 0.0 {
        for p in &mut in_camera {
            *p = -*p;
        }
    }
    align_points(points, &in_camera)
}

/// Sum of the squared residuals in normalized coordinates; infinite where a point is behind the camera.
fn total_error(points: &[Vector3<f64>], normalized: &[Vector2<f64>], world_from_camera: &Pose) -> f64 {
    let squared = |(point, seen): (&Vector3<f64>, &Vector2<f64>)| {
        let p = world_from_camera.inverse_transform(point);
        if p.z > 0.0 { (seen - p.xy() / p.z).norm_squared() } else { f64::INFINITY }
    };
    points.iter().zip(normalized).map(squared).sum()
}
