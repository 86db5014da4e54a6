//! Who may do what: Zenoh's access control by the common name of the other side's certificate.
//!
//! | role | may |
//! |---|---|
//! | robot | query maps, hand in its own sessions, read the changes of maps, publish below its own name, receive its own sensors |
//! | map server | answer for maps, publish their changes, ask other servers for cells of maps |
//! | operator | query maps, hand in sessions, read what robots and servers publish |
//! | router | forward |
//!
//! What is not allowed is denied. The hub applies this to all that comes from a member. A member applies to the hub what
//! it has use for: a map server takes no answers but those of cells, a robot takes no queries.

use super::state::FleetState;
use client::session::{Member, Role};
use serde_json::{Value, json};

/// What a subscriber of liveliness tokens sends.
const WATCH: [&str; 2] = ["liveliness_query", "declare_liveliness_subscriber"];
/// All kinds of messages.
const ALL: [&str; 9] = [
    "put",
    "delete",
    "declare_subscriber",
    "query",
    "reply",
    "declare_queryable",
    "liveliness_token",
    "liveliness_query",
    "declare_liveliness_subscriber",
];

/// Common name of a member's certificate.
pub fn common_name(member: &Member) -> String {
    let name = &member.name;
    match member.role {
        Role::Router => name.clone(),
        Role::MapServer => format!("map_server/{name}"),
        Role::Robot => format!("robot/{name}"),
        Role::Operator => format!("operator/{name}"),
    }
}

/// Messages that are allowed on keys.
type Allowed = (Vec<&'static str>, Vec<String>);

/// The access control of a member's node.
pub(super) fn control(fleet: &FleetState, own: &Member) -> Value {
    let hub = fleet.hub();
    let mut control = AccessControl { fleet, rules: Vec::new(), subjects: Vec::new(), policies: Vec::new() };
    if own == hub {
        for member in fleet.members().iter().filter(|member| *member != own) {
            control.add(member, from_member(member, &fleet.maps));
        }
        if hub.role == Role::Router {
            // Another router of the same fleet.
            control.add(hub, vec![(ALL.to_vec(), everything())]);
        }
    } else {
        control.add(hub, from_hub(own));
    }
    json!({
        "enabled": true,
        "default_permission": "deny",
        "rules": control.rules,
        "subjects": control.subjects,
        "policies": control.policies,
    })
}

/// What may come from a member to the hub.
fn from_member(member: &Member, maps: &[String]) -> Vec<Allowed> {
    let name = &member.name;
    let of_maps = |suffix: &str| match maps {
        [] => vec![format!("map/*/{suffix}")],
        maps => maps.iter().map(|map| format!("map/{map}/{suffix}")).collect(),
    };
    let queries =
        || [of_maps("match"), of_maps("localize"), of_maps("info"), of_maps("keyframes/*")].concat();
    let all_maps = || vec!["map/**".to_owned()];
    let tokens_of_cells = |name: &str| {
        let suffixes = ["server", "cell/*/server", "version/*/server"];
        suffixes.iter().flat_map(|suffix| of_maps(&format!("{suffix}/{name}"))).collect::<Vec<_>>()
    };
    match member.role {
        Role::Router => vec![(ALL.to_vec(), everything())],
        Role::Robot => vec![
            (vec!["query"], [queries(), of_maps(&format!("sessions/{name}"))].concat()),
            (vec!["declare_subscriber"], [of_maps("changes"), vec![sensors_of(name)]].concat()),
            (vec!["put"], vec![format!("robot/{name}/*"), sensors_of(name)]),
            (vec!["liveliness_token"], vec![format!("robot/{name}"), format!("robot/{name}/session/*")]),
            (WATCH.to_vec(), vec![format!("robot/{name}/session/*"), "map_server/*".to_owned()]),
        ],
        // Queries of maps that it does not have are refused under `map/*`.
        Role::MapServer => vec![
            (vec!["declare_queryable", "reply"], all_maps()),
            (vec!["put"], of_maps("changes")),
            (
                vec!["query"],
                [of_maps("cell/*/match"), of_maps("cell/*/localize"), of_maps("cell/*/keyframes/*")].concat(),
            ),
            (vec!["liveliness_token"], [vec![format!("map_server/{name}")], tokens_of_cells(name)].concat()),
            // Its own name: whether another server has it.
            (WATCH.to_vec(), [vec![format!("map_server/{name}")], tokens_of_cells("*")].concat()),
        ],
        Role::Operator => vec![
            (vec!["query"], [queries(), of_maps("sessions/*")].concat()),
            (vec!["declare_subscriber"], [of_maps("changes"), vec!["robot/**".to_owned()]].concat()),
            (WATCH.to_vec(), everything()),
        ],
    }
}

/// What a robot's drivers publish, with its certificate.
fn sensors_of(robot: &str) -> String {
    format!("robot/{robot}/sensors/*")
}

/// What may come from the hub to a member.
fn from_hub(own: &Member) -> Vec<Allowed> {
    let all_maps = || vec!["map/**".to_owned()];
    let changes = || vec!["map/*/changes".to_owned()];
    let declarations =
        vec!["declare_subscriber", "liveliness_token", "liveliness_query", "declare_liveliness_subscriber"];
    let mut allowed = vec![(declarations, everything())];
    allowed.extend(match own.role {
        Role::Robot => vec![
            (vec!["reply", "declare_queryable"], all_maps()),
            (vec!["put"], [changes(), vec![sensors_of(&own.name)]].concat()),
        ],
        Role::MapServer => vec![
            (vec!["query"], all_maps()),
            (vec!["reply", "declare_queryable"], vec!["map/*/cell/**".to_owned()]),
        ],
        Role::Operator => vec![
            (vec!["reply", "declare_queryable"], all_maps()),
            (vec!["put"], [changes(), vec!["robot/**".to_owned()]].concat()),
        ],
        Role::Router => vec![(ALL.to_vec(), everything())],
    });
    allowed
}

fn everything() -> Vec<String> {
    vec!["**".to_owned()]
}

struct AccessControl<'a> {
    fleet: &'a FleetState,
    rules: Vec<Value>,
    subjects: Vec<Value>,
    policies: Vec<Value>,
}

impl AccessControl<'_> {
    /// Allows a member to send some messages, and to receive all.
    fn add(&mut self, member: &Member, allowed: Vec<Allowed>) {
        let who = common_name(member);
        let mut names = Vec::new();
        let to_it = (ALL.to_vec(), everything());
        for (flow, (messages, keys)) in
            allowed.into_iter().map(|allowed| ("ingress", allowed)).chain([("egress", to_it)])
        {
            let id = format!("{who} {flow} {}", names.len());
            let keys: Vec<String> = keys.into_iter().map(|key| self.in_namespace(key)).collect();
            self.rules.push(json!({
                "id": id, "flows": [flow], "permission": "allow", "messages": messages, "key_exprs": keys
            }));
            names.push(id);
        }
        self.subjects.push(json!({ "id": who, "cert_common_names": [who] }));
        self.policies.push(json!({ "rules": names, "subjects": [who] }));
    }

    fn in_namespace(&self, key: String) -> String {
        match &self.fleet.namespace {
            Some(namespace) => format!("{namespace}/{key}"),
            None => key,
        }
    }
}
