"""What `cablequad check` found, in a line and as a page."""

from typing import Any

from rich.console import Console
from rich.table import Table

from missions.analysis.check import SETTLE_S


def summary(result: dict[str, Any]) -> str:
    """What the page comes to, in a line."""
    if result["cannot_fly"]:
        return "cannot fly"
    c, m = result["closed_loop"], result["margins"]
    if c["slowest_time_constant_s"] is None:
        return "unstable as flown"
    certified = "certified" if result["certificate"]["certified"] else "not certified (which is no verdict: see there)"
    return (
        f"stable as flown; {100 * max(result['equilibrium']['thrust_share']):.0f} % of the thrust at hover; stands "
        f"{m['delay_ms']:.0f} ms of delay at one input and {100 * result['largest_loss']:.0f} % of setpoints lost; "
        f"{certified}"
    )


def show(result: dict[str, Any], console: Console) -> None:
    """The result as a page, without its heading."""
    e, c, m = result["equilibrium"], result["closed_loop"], result["margins"]
    if result["out_of_reach"]:
        console.print(f"out of reach of the vehicles' forces, and left out: {', '.join(result['out_of_reach'])}")
    if result["hidden"]:
        console.print(f"not shown by anything that is measured ({result['sensing']}): {', '.join(result['hidden'])}")
    thrust = ", ".join(f"{t:.2f}" for t in e["thrust_N"])
    console.print(
        f"equilibrium: load tilted {e['load_tilt_deg']:.1f} deg; tensions at the load "
        f"{', '.join(f'{t:.2f}' for t in e['tension_N'])} N; thrusts {thrust} N, "
        f"{100 * max(e['thrust_share']):.0f} % of the limit"
    )
    console.print(
        f"stiffest link mode {result['stiffest_link_mode_rad_s']:.0f} rad/s, "
        f"physics step {result['physics_step_us']} us"
    )
    table = Table(
        title="open loop: the modes that the vehicles move least (PBH: smallest singular value of [A - pole I, B])",
        title_justify="left",
    )
    for name in ("pole [1/s]", "PBH margin", "where", ""):
        table.add_column(name)
    for mode in result["modes"][:5]:
        pole = f"{mode['pole'][0]:.2g} {mode['pole'][1]:+.2f}i"
        table.add_row(pole, f"{mode['pbh']:.2e}", mode["motion"], "weakly controllable" if mode["weak"] else "")
    console.print(table)
    console.print(f"every mode controllable: {'yes' if result['controllable'] else 'NO'}")
    slow, apart = c["slowest_time_constant_s"], result["gains"]["difference_to_dlqr"]
    if apart is not None:
        console.print(f"gains: as control.dlqr has them, but for {apart:.0e}")
    console.print(
        f"closed loop as flown: spectral radius {c['spectral_radius']:.6f}, "
        + (f"slowest time constant {slow:.2f} s, " if slow is not None else "[bold]unstable[/bold], ")
        + f"least damping ratio {c['least_damping_ratio'] or 0:.3f}"
    )
    console.print(
        f"margins: one input at a time gain x {m['gain_up']:.1f} up, x {m['gain_down']:.2f} down, "
        f"phase {m['phase_deg']:.0f} deg ({m['worst_input']}), delay {m['delay_ms']:.0f} ms; all inputs at once disk "
        f"{m['disk']:.2f} (gain x {m['disk_gain'][0]:.2f} .. {m['disk_gain'][1]:.2f}, "
        f"phase {m['disk_phase_deg']:.0f} deg), {m['delay_ticks_all']} more ticks of delay "
        f"({m['delay_ticks_all'] * result['period_ms']:.0f} ms)"
    )
    console.print(
        f"largest loss of setpoints: {100 * result['largest_loss']:.0f} % of all ticks, independent of each other, the "
        "setpoints before held (mean square stability)"
    )
    _show_certificate(result["certificate"], console)
    if "region_of_attraction" in result:
        table = Table(
            title=f"what settles within {SETTLE_S:.0f} s in simulation, from rest at the target", title_justify="left"
        )
        table.add_column("direction")
        table.add_column("up to", justify="right")
        for row in result["region_of_attraction"]:
            more = " (all that was tried)" if row["settles_up_to"] == row["tried_up_to"] else ""
            table.add_row(row["direction"], f"{row['settles_up_to']:.1f} {row['unit']}{more}")
        console.print(table)


def _show_certificate(c: dict[str, Any], console: Console) -> None:
    table = Table(title="certificate of Proposition 3, for the paper's law with these weights", title_justify="left")
    for name in ("condition", "value", "", "bound", ""):
        table.add_column(name)
    for name, row in c["conditions"].items():
        table.add_row(
            name, f"{row['value']:.2e}", row["side"], f"{row['bound']:.2e}", "holds" if row["holds"] else "FAILS"
        )
    console.print(table)
    console.print(
        f"K_max {c['K_max']:.2f}, B_1 {c['B_1']:.2f} N, B_2 {max(c['B_2']):.3f}, c_2 {min(c['c_2']):.2f} of at most "
        f"{min(c['c_2_bound']):.2f}, lambda_m(W_2) {min(c['lambda_W_2']):.3f}"
    )
    title = "Lyapunov equation for some Q (P and c_3 scale with Q, alpha does not)"
    table = Table(title=title, title_justify="left")
    for name in ("Q", "lambda_min(Q)", "|P|", "|P B_d|", "c_3", "alpha below"):
        table.add_column(name, justify="right")
    for q in c["lyapunov"]:
        table.add_row(
            q["Q"], f"{q['lambda_min_Q']:.2g}", f"{q['norm_P']:.4g}", f"{q['norm_P_B_d']:.4g}", f"{q['c_3']:.4g}",
            f"{q['alpha_max']:.2e}",
        )  # fmt: skip
    console.print(table)
    table = Table(title="the gamma - psi_1 curve", title_justify="left")
    for name in ("psi_1", "largest gamma", "radius |z_1|", "Q", "scale of Q", "lambda_m(W_2) over needed"):
        table.add_column(name, justify="right")
    for p in c["curve"]:
        table.add_row(
            f"{p['psi_1']:.1e}", f"{p['gamma']:.2e}", f"{p['radius']:.1e}", p["Q"], f"{p['scale']:.0e}",
            f"{p['lambda_W_2_over_needed']:.1e}",
        )  # fmt: skip
    console.print(table)
    verdict = "certified" if c["certified"] else "not certified for this flight"
    local = "; exponentially stable near the equilibrium" if c["locally_stable"] and not c["certified"] else ""
    console.print(f"[bold]verdict: {verdict}{local}[/bold]")
    if not c["certified"]:
        console.print(
            "  The certificate is sufficient, not necessary: worst-case bounds for every start and motion within its "
            "radius. Margins and flights say what the loop stands."
        )
    for line in c.get("advice", []):
        console.print("  - " + line)
