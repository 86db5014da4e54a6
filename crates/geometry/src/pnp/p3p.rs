//! The pose from three points.
//!
//! With unit bearings `b_i`, depths `d_i` and squared distances `a_ij = |P_i - P_j|^2`, the law of cosines gives three
//! quadrics in the depths, `d^T M_ij d = a_ij`. Two combinations without a constant are cones `D_1, D_2`; the pencil
//! `D_1 + g D_2` holds a pair of planes where `det = 0` (a cubic in g). On each plane a cone leaves a quadratic for the
//! direction of d, and the distances give its length. Newton steps on the three quadrics bring it to rounding precision.
//!
//! Source: Persson & Nordberg, "Lambda Twist: an accurate fast robust perspective three point solver", ECCV 2018; the
//! quadratic on the planes is solved in homogeneous form here.

use super::PnpError;
use crate::pose::Pose;
use crate::rotation::Rotation;
use nalgebra::{Matrix2, Matrix3, Matrix3x2, Rotation3, SymmetricEigen, Unit, UnitVector3, Vector3};

/// Sine of an angle of the triangle, or between rays, below which the problem is degenerate.
const DEGENERATE_SINE: f64 = 1e-7;
/// Newton steps on the depths; a simple root needs two or three, a double root converges linearly.
const POLISH_STEPS: usize = 12;
/// Maximum residual of the three quadrics relative to the largest squared distance.
const ACCEPTED_RESIDUAL: f64 = 1e-9;
/// Relative difference of depths below which solutions are identical.
const SAME_SOLUTION: f64 = 1e-9;

/// Up to four poses `world_from_camera` from three points.
///
/// # Arguments
/// * `bearings`: unit vectors in the camera frame.
/// * `points`: in the world frame, metres, in the same order.
///
/// # Errors
/// [`PnpError::Degenerate`] if the points are collinear or two rays coincide, [`PnpError::NoSolution`] if no pose
/// has the three points in front of the camera, [`PnpError::InvalidInput`].
pub fn p3p(bearings: &[UnitVector3<f64>; 3], points: &[Vector3<f64>; 3]) -> Result<Vec<Pose>, PnpError> {
    let rays = bearings.map(Unit::into_inner);
    if !points.iter().chain(&rays).all(|v| v.iter().all(|value| value.is_finite())) {
        return Err(PnpError::InvalidInput);
    }
    let problem = Distances::new(&rays, points).ok_or(PnpError::Degenerate)?;
    let mut found: Vec<Vector3<f64>> = Vec::with_capacity(4);
    for direction in problem.directions() {
        let Some(depths) = problem.scale(&direction).and_then(|start| problem.polish(start)) else {
            continue;
        };
        let known = found.iter().any(|other| (other - depths).norm() <= SAME_SOLUTION * depths.norm());
        if !known {
            found.push(depths);
        }
    }
    if found.is_empty() {
        return Err(PnpError::NoSolution);
    }
    Ok(found.iter().map(|depths| pose_of_depths(depths, &rays, points)).collect())
}

/// The pairs of rays in the order of the quadrics.
const PAIRS: [(usize, usize); 3] = [(0, 1), (0, 2), (1, 2)];

/// The three quadrics `d^T M d = a`.
struct Distances {
    /// Cosines between the rays of each pair.
    cosines: [f64; 3],
    /// Squared distances of each pair, scaled so that the largest is one.
    squared: [f64; 3],
    /// The scale of `squared` (m^2).
    unit: f64,
}

impl Distances {
    fn new(rays: &[Vector3<f64>; 3], points: &[Vector3<f64>; 3]) -> Option<Self> {
        let [u, v] = [points[1] - points[0], points[2] - points[0]];
        let squared = PAIRS.map(|(i, j)| (points[i] - points[j]).norm_squared());
        let unit = squared.iter().copied().fold(0.0, f64::max);
        let collinear = u.cross(&v).norm() <= DEGENERATE_SINE * unit;
        let coinciding = PAIRS.iter().any(|&(i, j)| rays[i].cross(&rays[j]).norm() <= DEGENERATE_SINE);
        if collinear || coinciding || unit <= 0.0 {
            return None;
        }
        Some(Self {
            cosines: PAIRS.map(|(i, j)| rays[i].dot(&rays[j])),
            squared: squared.map(|a| a / unit),
            unit,
        })
    }

    fn matrix(&self, pair: usize) -> Matrix3<f64> {
        let (i, j) = PAIRS[pair];
        let mut m = Matrix3::zeros();
        m[(i, i)] = 1.0;
        m[(j, j)] = 1.0;
        m[(i, j)] = -self.cosines[pair];
        m[(j, i)] = -self.cosines[pair];
        m
    }

    /// The common directions of both cones, with positive components.
    fn directions(&self) -> Vec<Vector3<f64>> {
        let m = [self.matrix(0), self.matrix(1), self.matrix(2)];
        let d1 = (m[0] * self.squared[2] - m[2] * self.squared[0]).normalize();
        let d2 = (m[1] * self.squared[2] - m[2] * self.squared[1]).normalize();
        // det(D1 + g D2) = c0 + c1 g + c2 g^2 + c3 g^3; swapped if needed so that |c3| >= |c0|.
        let (d1, d2) = if d2.determinant().abs() >= d1.determinant().abs() { (d1, d2) } else { (d2, d1) };
        let cubic = pencil_cubic(&d1, &d2);
        let (degenerate, cone) = match steepest_root(&cubic) {
            Some(g) if g.abs() > 1.0 => (d1 + d2 * g, d1),
            Some(g) => (d1 + d2 * g, d2),
            None => (d2, d1),
        };
        let mut directions = Vec::with_capacity(4);
        for normal in plane_pair(&degenerate) {
            let basis = plane_basis(&normal);
            let conic: Matrix2<f64> = basis.transpose() * cone * basis;
            let (a, b, c) = (conic.m11, conic.m12, conic.m22);
            let discriminant = b * b - a * c;
            let size = b * b + (a * c).abs();
            if discriminant < -1e-10 * size || size == 0.0 {
                continue;
            }
            let q = -(b + discriminant.max(0.0).sqrt().copysign(b));
            for (x, y) in [(q, a), (c, q)] {
                let direction = basis * nalgebra::Vector2::new(x, y);
                let direction = if direction.sum() < 0.0 { -direction } else { direction };
                let norm = direction.norm();
                // A little below zero may still be polished to a solution in front of the camera.
                if norm > 0.0 && direction.min() > -1e-3 * norm {
                    directions.push(direction / norm);
                }
            }
        }
        directions
    }

    /// The depths along a direction (scaled units), from the sum of the three quadrics.
    fn scale(&self, direction: &Vector3<f64>) -> Option<Vector3<f64>> {
        let form: f64 = (0..3).map(|pair| direction.dot(&(self.matrix(pair) * direction))).sum();
        let scale = (self.squared.iter().sum::<f64>() / form).sqrt();
        scale.is_finite().then(|| direction * scale)
    }

    /// Newton on the three quadrics. Returns depths in metres, or `None` if they are not in front of the camera.
    fn polish(&self, mut depths: Vector3<f64>) -> Option<Vector3<f64>> {
        let mut residual = self.residual(&depths);
        for _ in 0..POLISH_STEPS {
            let mut jacobian = Matrix3::zeros();
            for (row, &(i, j)) in PAIRS.iter().enumerate() {
                jacobian[(row, i)] = 2.0 * (depths[i] - self.cosines[row] * depths[j]);
                jacobian[(row, j)] = 2.0 * (depths[j] - self.cosines[row] * depths[i]);
            }
            let Some(step) = jacobian.try_inverse().map(|inverse| inverse * residual) else { break };
            let candidate = depths - step;
            let candidate_residual = self.residual(&candidate);
            if candidate_residual.norm() >= residual.norm() {
                break;
            }
            (depths, residual) = (candidate, candidate_residual);
        }
        let scale = self.unit.sqrt();
        let solved = residual.norm() <= ACCEPTED_RESIDUAL * (1.0 + depths.norm_squared());
        (solved && depths.min() > 0.0).then(|| depths * scale)
    }

    fn residual(&self, d: &Vector3<f64>) -> Vector3<f64> {
        let row = |pair: usize| {
            let (i, j) = PAIRS[pair];
            d[i] * d[i] + d[j] * d[j] - 2.0 * self.cosines[pair] * d[i] * d[j] - self.squared[pair]
        };
        Vector3::new(row(0), row(1), row(2))
    }
}

/// Coefficients of `det(a + g b)`, constant first.
fn pencil_cubic(a: &Matrix3<f64>, b: &Matrix3<f64>) -> [f64; 4] {
    let mixed = |x: &Matrix3<f64>, y: &Matrix3<f64>| {
        // The part of det(x + g y) that is linear in g: one column of y at a time.
        (0..3)
            .map(|column| {
                let mut m = *x;
                m.set_column(column, &y.column(column));
                m.determinant()
            })
            .sum::<f64>()
    };
    [a.determinant(), mixed(a, b), mixed(b, a), b.determinant()]
}

/// The real root of a cubic (constant first) with the steepest slope, polished; `None` if the cubic coefficient vanishes.
///
/// Any real root is valid: if the cones intersect in real directions, the planes of every real root are real.
fn steepest_root(c: &[f64; 4]) -> Option<f64> {
    let largest = c.iter().fold(0.0_f64, |m, value| m.max(value.abs()));
    if c[3].abs() <= 1e-14 * largest || largest == 0.0 {
        return None;
    }
    let (a2, a1, a0) = (c[2] / c[3], c[1] / c[3], c[0] / c[3]);
    let value = |x: f64| a0 + x * (a1 + x * (a2 + x));
    let slope = |x: f64| a1 + x * (2.0 * a2 + 3.0 * x);
    let shift = a2 / 3.0;
    let p = a1 - a2 * shift;
    let q = value(-shift);
    let discriminant = 0.25 * q * q + p * p * p / 27.0;
    let mut roots = [f64::NAN; 3];
    if discriminant > 0.0 {
        let u = (-0.5 * q - discriminant.sqrt().copysign(q)).cbrt();
        roots[0] = u - p / (3.0 * u) - shift;
    } else {
        let m = (-p / 3.0).max(0.0).sqrt();
        let cosine = if m > 0.0 { (-0.5 * q / (m * m * m)).clamp(-1.0, 1.0) } else { 1.0 };
        for (k, root) in roots.iter_mut().enumerate() {
            *root = 2.0 * m * ((cosine.acos() + std::f64::consts::TAU * k as f64) / 3.0).cos() - shift;
        }
    }
    let steepest = roots
        .into_iter()
        .filter(|root| root.is_finite())
        .max_by(|x, y| slope(*x).abs().total_cmp(&slope(*y).abs()))?;
    let mut root = steepest;
    for _ in 0..4 {
        let next = root - value(root) / slope(root);
        if !next.is_finite() || value(next).abs() >= value(root).abs() {
            break;
        }
        root = next;
    }
    Some(root)
}

/// The normals of the two planes of a symmetric matrix of rank two with eigenvalues of different signs.
fn plane_pair(matrix: &Matrix3<f64>) -> [Vector3<f64>; 2] {
    let eigen = SymmetricEigen::new(*matrix);
    let values = eigen.eigenvalues;
    let (positive, negative) = (values.imax(), values.imin());
    let e = eigen.eigenvectors.column(positive) * values[positive].max(0.0).sqrt();
    let f = eigen.eigenvectors.column(negative) * (-values[negative]).max(0.0).sqrt();
    [e + f, e - f]
}

/// An orthonormal basis of the plane with a normal of any length.
fn plane_basis(normal: &Vector3<f64>) -> Matrix3x2<f64> {
    let n = normal.normalize();
    let mut axis = Vector3::zeros();
    axis[n.iamin()] = 1.0;
    let first = n.cross(&axis).normalize();
    Matrix3x2::from_columns(&[first, n.cross(&first)])
}

/// The pose that maps the triangle in the camera frame to the triangle in the world frame.
fn pose_of_depths(depths: &Vector3<f64>, rays: &[Vector3<f64>; 3], points: &[Vector3<f64>; 3]) -> Pose {
    let seen = [rays[0] * depths[0], rays[1] * depths[1], rays[2] * depths[2]];
    let matrix = triangle_axes(points) * triangle_axes(&seen).transpose();
    let rotation = Rotation::from_rotation_matrix(&Rotation3::from_matrix_unchecked(matrix));
    let centroid = |p: &[Vector3<f64>; 3]| (p[0] + p[1] + p[2]) / 3.0;
    Pose::new(rotation, centroid(points) - rotation * centroid(&seen))
}

/// Orthonormal axes fixed to a triangle, as columns.
fn triangle_axes(p: &[Vector3<f64>; 3]) -> Matrix3<f64> {
    let first = (p[1] - p[0]).normalize();
    let third = first.cross(&(p[2] - p[0])).normalize();
    Matrix3::from_columns(&[first, third.cross(&first), third])
}
