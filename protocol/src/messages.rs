//! The messages: tag in the bincode envelope and name in JSON. The tag and name of `MatchReply` (2) are with its own JSON
//! form, in `matching`.

use crate::cells::{CellLocalizeReply, CellMatchReply};
use crate::codec::Message;
use crate::error_reply::ErrorReply;
use crate::hand_in::{SessionPart, SessionPartReply};
use crate::localize::{LocalizeReply, LocalizeRequest};
use crate::map::{KeyframeReply, MapChangeNotice, MapInfoReply};
use crate::matching::MatchRequest;
use crate::robot::{RobotOdometry, RobotPose, RobotStatus};

macro_rules! messages {
    ($($tag:literal $name:literal $message:ty;)*) => {
        $(impl Message for $message {
            const TAG: u16 = $tag;
            const NAME: &'static str = $name;
        })*
    };
}

messages! {
    1 "match_request" MatchRequest;
    3 "localize_request" LocalizeRequest;
    4 "localize_reply" LocalizeReply;
    5 "map_info_reply" MapInfoReply;
    6 "keyframe_reply" KeyframeReply;
    7 "map_change_notice" MapChangeNotice;
    8 "robot_pose" RobotPose;
    9 "robot_odometry" RobotOdometry;
    10 "robot_status" RobotStatus;
    11 "error_reply" ErrorReply;
    12 "cell_match_reply" CellMatchReply;
    13 "cell_localize_reply" CellLocalizeReply;
    14 "session_part" SessionPart;
    15 "session_part_reply" SessionPartReply;
}
