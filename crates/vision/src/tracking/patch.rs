//! Square patches of samples, and sums over them.

/// Samples per side of a patch. Over rendered motions 97.0, 99.9 and 100 % of the points are within 0.2 px with
/// 12, 16 and 20; over warped EuRoC images 93, 96 and 97 %.
pub(super) const SIDE: usize = 16;
/// Number of samples of a patch.
pub(super) const SAMPLES: f32 = (SIDE * SIDE) as f32;
/// Half the distance between the outer samples of a patch, pixels.
pub(super) const HALF: f32 = (SIDE as f32 - 1.0) / 2.0;

/// The samples of a patch, row after row.
pub(super) type Patch = [[f32; SIDE]; SIDE];

/// A patch of zeros.
pub(super) const ZERO: Patch = [[0.0; SIDE]; SIDE];

/// Scalar product of two patches.
#[inline(always)]
pub(super) fn dot(a: &Patch, b: &Patch) -> f32 {
    let mut sums = [0.0f32; SIDE];
    for (row_a, row_b) in a.iter().zip(b) {
        for i in 0..SIDE {
            sums[i] += row_a[i] * row_b[i];
        }
    }
    total(sums)
}

/// Mean of the samples.
#[inline(always)]
pub(super) fn mean(patch: &Patch) -> f32 {
    let mut sums = [0.0f32; SIDE];
    for row in patch {
        for i in 0..SIDE {
            sums[i] += row[i];
        }
    }
    total(sums) / SAMPLES
}

/// Subtracts `constant + factor * other`, sample by sample.
#[inline(always)]
pub(super) fn subtract(target: &mut Patch, constant: f32, factor: f32, other: &Patch) {
    for (row, row_other) in target.iter_mut().zip(other) {
        for i in 0..SIDE {
            row[i] -= constant + factor * row_other[i];
        }
    }
}

/// The sum of the lanes of a running sum, in pairs: fewer operations wait for each other than in a row.
#[inline(always)]
pub(super) fn total(mut sums: [f32; SIDE]) -> f32 {
    let mut half = SIDE / 2;
    while half > 0 {
        for i in 0..half {
            sums[i] += sums[i + half];
        }
        half /= 2;
    }
    sums[0]
}
