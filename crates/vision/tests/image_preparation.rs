//! Laws of pyramids and equalization.

use vision::{GrayImage, LocalEqualization, Pyramid, equalize, equalize_locally};

fn noise(width: usize, height: usize, darkest: u32, span: u32) -> GrayImage {
    let mut state = 1u32;
    GrayImage::from_fn(width, height, |_, _| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (darkest + (state >> 16) % span) as u8
    })
}

#[test]
fn the_pyramid_of_a_constant_is_constant() {
    for (width, height) in [(64, 48), (65, 49), (751, 480)] {
        let pyramid = Pyramid::new(GrayImage::from_fn(width, height, |_, _| 255), 4);
        for level in 0..pyramid.levels() {
            assert!(pyramid.level(level).pixels().iter().all(|pixel| *pixel == 255));
        }
    }
}

#[test]
fn every_level_is_half_as_large_and_none_too_small() {
    let pyramid = Pyramid::new(noise(101, 67, 0, 256), 9);
    let sizes: Vec<_> = (0..pyramid.levels())
        .map(|level| (pyramid.level(level).width(), pyramid.level(level).height()))
        .collect();
    assert_eq!(sizes, [(101, 67), (51, 34), (26, 17)]);
}

#[test]
fn a_level_is_the_image_smoothed_by_the_binomial_kernel_at_every_second_pixel() {
    let image = noise(41, 33, 0, 256);
    let half = Pyramid::new(image.clone(), 2);
    let kernel = [1.0, 4.0, 6.0, 4.0, 1.0];
    for y in 0..17 {
        for x in 0..21 {
            let mut sum = 0.0;
            for (dy, wy) in kernel.iter().enumerate() {
                for (dx, wx) in kernel.iter().enumerate() {
                    let column = (2 * x + dx).saturating_sub(2).min(40);
                    let row = (2 * y + dy).saturating_sub(2).min(32);
                    sum += wx * wy / 256.0 * f64::from(image.get(column, row));
                }
            }
            assert!((f64::from(half.level(1).get(x, y)) - sum).abs() <= 0.5 + 1e-9);
        }
    }
}

#[test]
fn global_equalization_keeps_the_order_of_grey_levels_and_fills_the_range() {
    let image = noise(120, 80, 60, 40);
    let equalized = equalize(&image);
    let mut table = [None; 256];
    for (before, after) in image.pixels().iter().zip(equalized.pixels()) {
        assert_eq!(*table[usize::from(*before)].get_or_insert(*after), *after, "one level, one result");
    }
    let levels: Vec<u8> = table.iter().flatten().copied().collect();
    assert!(levels.is_sorted());
    assert_eq!((levels[0], levels[levels.len() - 1]), (0, 255));
    let constant = GrayImage::from_fn(10, 10, |_, _| 77);
    assert_eq!(equalize(&constant), constant);
}

#[test]
fn local_equalization_raises_contrast_where_it_is_low_and_no_further_than_the_limit() {
    // The left half is dark and faint, the right half is bright and strong.
    let (faint, strong) = (noise(320, 200, 20, 16), noise(320, 200, 60, 180));
    let image = GrayImage::from_fn(320, 200, |x, y| if x < 160 { faint.get(x, y) } else { strong.get(x, y) });
    let options = LocalEqualization { tiles: [8, 5], clip: 3.0 };
    let equalized = equalize_locally(&image, &options);
    let spread = |image: &GrayImage, from: usize| {
        let mut values: Vec<u8> =
            (20..180).flat_map(|y| image.row(y)[from..from + 80].iter().copied()).collect();
        values.sort_unstable();
        f64::from(values[values.len() * 9 / 10]) - f64::from(values[values.len() / 10])
    };
    let gain = spread(&equalized, 30) / spread(&image, 30);
    assert!(gain > 1.8, "contrast of the faint half grew by {gain}");
    assert!(gain <= 3.0 + 1.0, "the limit holds, spread-out excess adds one: {gain}");
    assert!(spread(&equalized, 200) > 0.8 * spread(&image, 200));
}

#[test]
fn local_equalization_of_tiny_images_and_single_tiles_works() {
    for tiles in [[1, 1], [100, 100], [0, 0]] {
        let image = noise(5, 3, 0, 256);
        let equalized = equalize_locally(&image, &LocalEqualization { tiles, clip: 2.0 });
        assert_eq!((equalized.width(), equalized.height()), (5, 3));
    }
}
