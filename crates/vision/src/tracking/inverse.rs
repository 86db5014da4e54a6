//! Inverse of a small positive definite matrix.

/// The inverse of a symmetric positive definite matrix by Gauss-Jordan elimination in place, which needs no pivoting then.
///
/// # Returns
/// `None` if a pivot is not positive.
#[inline(always)]
pub(super) fn invert_positive<const N: usize>(mut matrix: [[f32; N]; N]) -> Option<[[f32; N]; N]> {
    for k in 0..N {
        let pivot = matrix[k][k];
        if !(pivot > 0.0 && pivot.is_finite()) {
            return None;
        }
        let reciprocal = 1.0 / pivot;
        matrix[k][k] = 1.0;
        for value in &mut matrix[k] {
            *value *= reciprocal;
        }
        let pivot_row = matrix[k];
        for (i, row) in matrix.iter_mut().enumerate() {
            if i == k {
                continue;
            }
            let factor = row[k];
            row[k] = 0.0;
            for j in 0..N {
                row[j] -= factor * pivot_row[j];
            }
        }
    }
    Some(matrix)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_inverse_undoes_the_matrix() {
        // Positive definite: rows of a matrix multiplied with each other, and scales that differ as those of a warp do.
        let rows: [[f32; 6]; 6] =
            std::array::from_fn(|i| std::array::from_fn(|j| ((i * 7 + j * j * 3) % 11) as f32 - 4.0));
        let scale = |i: usize| if i < 2 { 1.0 } else { 8.0 };
        let matrix: [[f32; 6]; 6] = std::array::from_fn(|i| {
            std::array::from_fn(|j| {
                let product: f32 = (0..6).map(|k| rows[i][k] * rows[j][k]).sum();
                (product + if i == j { 5.0 } else { 0.0 }) * scale(i) * scale(j)
            })
        });
        let inverse = invert_positive(matrix).expect("positive definite");
        for (i, row) in matrix.iter().enumerate() {
            for j in 0..6 {
                let product: f32 = row.iter().zip(&inverse).map(|(value, other)| value * other[j]).sum();
                assert!((product - f32::from(u8::from(i == j))).abs() < 1e-3, "{i} {j}: {product}");
            }
        }
    }

    #[test]
    fn a_singular_or_indefinite_matrix_has_none() {
        assert!(invert_positive([[1.0, 1.0], [1.0, 1.0]]).is_none());
        assert!(invert_positive([[1.0, 0.0], [0.0, -1.0]]).is_none());
        assert!(invert_positive([[f32::NAN, 0.0], [0.0, 1.0]]).is_none());
    }
}
