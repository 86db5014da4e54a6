//! Pixels of a row that a vectorized test has marked: few, so that whole groups are passed over.

/// Marks that are looked at together.
const TOGETHER: usize = 16;

/// The indices of what is marked, in ascending order.
pub(crate) fn marked(marks: &[bool]) -> impl Iterator<Item = usize> + '_ {
    marks.chunks(TOGETHER).enumerate().flat_map(|(chunk, marks)| {
        let marks = if marks.contains(&true) { marks } else { &[] };
        marks.iter().enumerate().filter(|(_, mark)| **mark).map(move |(k, _)| chunk * TOGETHER + k)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_marked_is_found_wherever_it_is() {
        for step in [1, 3, 16, 17, 40] {
            let marks: Vec<bool> = (0..75).map(|k| k % step == 0).collect();
            let expected: Vec<usize> = (0..75).step_by(step).collect();
            assert_eq!(marked(&marks).collect::<Vec<_>>(), expected);
        }
        assert_eq!(marked(&[]).count(), 0);
    }
}
