//! What most cameras of a rig say of the body, where they contradict each other.
//!
//! The tracks of a covered camera are noise that moves, those of a dirty one are dirt that does not, and what a camera sees may move by
//! itself. A single one of several cameras must neither keep a robot from starting nor make a moving one stand.

/// Whether more than half of the cameras that see enough find the body still.
///
/// # Arguments
/// * `stillness`: of each camera (of a stereo pair of the first one); `None` where it sees too little.
///
/// # Returns
/// `None` where no camera sees enough. Equal numbers of cameras on both sides are motion.
pub fn most_are_still(stillness: impl Iterator<Item = Option<bool>>) -> Option<bool> {
    let (mut still, mut moving) = (0_usize, 0_usize);
    for is_still in stillness.flatten() {
        *(if is_still { &mut still } else { &mut moving }) += 1;
    }
    (still + moving > 0).then_some(still > moving)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_camera_of_several_is_outvoted_and_where_two_disagree_the_body_moves() {
        let vote = |votes: &[Option<bool>]| most_are_still(votes.iter().copied());
        assert_eq!(vote(&[]), None);
        assert_eq!(vote(&[None, None]), None);
        assert_eq!(vote(&[None, Some(true)]), Some(true));
        assert_eq!(vote(&[Some(false)]), Some(false));
        assert_eq!(vote(&[Some(true), Some(false)]), Some(false));
        assert_eq!(vote(&[Some(true), Some(false), Some(false), None]), Some(false), "dirt does not move");
        assert_eq!(vote(&[Some(false), Some(true), Some(true), None]), Some(true), "noise does");
    }
}
