//! `driftless fleet`: certificates and access control for a fleet.

use std::path::{Path, PathBuf};

use client::session::Role;

use crate::fleet::{Fleet, FleetOptions, Validity};

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
#[command(
    arg_required_else_help = true,
    after_help = "Example:\n  \
        driftless fleet init fleet --address 10.0.0.1 --servers s1 --robots r1,r2 --operators ann\n  \
        map_server --map hall=hall.db --secure fleet/s1                 on the server, which has 10.0.0.1\n  \
        onboard --sequence REC --map hall --secure fleet/r1 --out out   on the robot\n\n\
        Copy each member's folder, and nothing else, to its machine. Keep fleet/authority to yourself: whoever has it can \
        make members."
)]
pub struct Args {
    #[command(subcommand)]
    action: Action,
}

/// What to do with the fleet.
#[derive(Clone, Debug, clap::Subcommand)]
enum Action {
    /// Write a new fleet: an authority, and a folder for each member
    Init(InitArgs),
    /// Add a robot
    AddRobot(AddArgs),
    /// Add a map server to a fleet with a router
    AddServer(AddArgs),
    /// Add an operator
    AddOperator(AddArgs),
    /// Make new keys and certificates for one member, or for all
    Renew(RenewArgs),
}

#[derive(Clone, Debug, clap::Args)]
struct InitArgs {
    /// Folder to write, which must not exist
    #[arg(value_name = "DIR")]
    folder: PathBuf,
    /// Names of the map servers, separated by commas
    #[arg(long, value_name = "NAMES", value_delimiter = ',', required = true)]
    servers: Vec<String>,
    /// Names of the robots, separated by commas
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    robots: Vec<String>,
    /// Names of those who query maps and watch the robots, separated by commas
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    operators: Vec<String>,
    /// Address of the machine that the others connect to: the router's, or the only server's
    #[arg(long, value_name = "HOST", default_value = "127.0.0.1")]
    address: String,
    /// Its port
    #[arg(long, value_name = "PORT", default_value_t = 7447)]
    port: u16,
    /// Meet at a Zenoh router (with several servers always)
    #[arg(long)]
    router: bool,
    /// The only map that may be queried [default: all]. May be given several times
    #[arg(long = "map", value_name = "NAME")]
    maps: Vec<String>,
    /// Prefix of all keys
    #[arg(long, value_name = "NAME")]
    namespace: Option<String>,
    #[command(flatten)]
    validity: ValidityArgs,
}

#[derive(Clone, Debug, clap::Args)]
struct AddArgs {
    /// Folder of the fleet
    #[arg(value_name = "DIR")]
    folder: PathBuf,
    /// Name of the new member
    name: String,
    #[command(flatten)]
    validity: ValidityArgs,
}

#[derive(Clone, Debug, clap::Args)]
struct RenewArgs {
    /// Folder of the fleet
    #[arg(value_name = "DIR")]
    folder: PathBuf,
    /// Name of the member [default: all members]
    name: Option<String>,
    #[command(flatten)]
    validity: ValidityArgs,
}

#[derive(Clone, Copy, Debug, clap::Args)]
struct ValidityArgs {
    /// How long the certificates are valid
    #[arg(long, value_name = "DAYS", default_value_t = 365, value_parser = clap::value_parser!(i64).range(1..3650))]
    days: i64,
}

impl ValidityArgs {
    fn validity(self) -> Validity {
        Validity::days(self.days)
    }
}

/// Runs the command.
///
/// # Errors
/// Names that are impossible or taken, a folder that exists already or holds no fleet, files that cannot be written.
pub fn run(args: Args) -> anyhow::Result<()> {
    match args.action {
        Action::Init(args) => init(args),
        Action::AddRobot(args) => add(&args, Role::Robot),
        Action::AddServer(args) => add(&args, Role::MapServer),
        Action::AddOperator(args) => add(&args, Role::Operator),
        Action::Renew(args) => {
            let renewed = Fleet::open(&args.folder)?.renew(args.name.as_deref(), args.validity.validity())?;
            for folder in renewed {
                println!(
                    "renewed {}: copy it to its machine and restart the program there",
                    folder.display()
                );
            }
            Ok(())
        }
    }
}

fn init(args: InitArgs) -> anyhow::Result<()> {
    let mut options = FleetOptions::new(&args.address);
    options.port = args.port;
    options.servers = args.servers;
    options.robots = args.robots;
    options.operators = args.operators;
    options.router = args.router;
    options.maps = args.maps;
    options.namespace = args.namespace;
    let fleet = Fleet::init(&args.folder, options, args.validity.validity())?;
    let hub = fleet.hub();
    for member in fleet.members() {
        println!("{:<11} {}", member.role.words(), fleet.folder_of(&member.name).display());
    }
    println!("All connect to {} {} at {}:{}.", hub.role.words(), hub.name, args.address, args.port);
    println!("Copy each folder to its machine, and start the programs there with --secure DIR.");
    println!(
        "Keep {} to yourself: whoever has it can make members.",
        args.folder.join("authority").display()
    );
    Ok(())
}

fn add(args: &AddArgs, role: Role) -> anyhow::Result<()> {
    let mut fleet = Fleet::open(&args.folder)?;
    let folder = fleet.add(role, &args.name, args.validity.validity())?;
    println!("{:<11} {}", role.words(), folder.display());
    say_hub_changed(&fleet, &args.folder);
    Ok(())
}

fn say_hub_changed(fleet: &Fleet, folder: &Path) {
    let hub = fleet.hub();
    println!(
        "{} {} knows it by its new configuration: copy {} to its machine, and restart it.",
        hub.role.words(),
        hub.name,
        folder.join(&hub.name).join(client::session::CONFIG_FILE).display()
    );
}
