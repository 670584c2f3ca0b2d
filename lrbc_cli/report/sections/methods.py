"""Section of the page with a paragraph on the method, in the numbers of this campaign, to quote in a report, and what to cite."""

from __future__ import annotations

from lrbc_cli.report.content import Content
from lrbc_cli.report.drawing import format as fmt
from lrbc_cli.report.html import Markup, tag
from lrbc_cli.report.parts.calibration import serves
from lrbc_cli.report.parts.tables import listed

CITATION = (
    "S. van Ophem, A. van de Walle, E. Deckers, W. Desmet, Efficient vibro-acoustic identification of boundary conditions by low-rank "
    "parametric model order reduction, preprint submitted to Mechanical Systems and Signal Processing, 5 April 2018."
)
BIBTEX = """@unpublished{vanOphem2018,
  author = {van Ophem, S. and van de Walle, A. and Deckers, E. and Desmet, W.},
  title  = {Efficient vibro-acoustic identification of boundary conditions by low-rank parametric model order reduction},
  note   = {Preprint submitted to Mechanical Systems and Signal Processing},
  month  = apr,
  year   = {2018}
}"""
_OPTIMISERS = {"gauss-newton": "a Gauss-Newton method with bounds", "bfgs": "BFGS"}


def methods_parts(content: Content) -> list[Markup | None]:
    """Return the parts of the section."""
    text = " ".join(
        sentence for sentence in (_measured(content), _model(content), _updating(content), _judged(content), _tools(content)) if sentence
    )
    return [
        tag(
            "p",
            "A paragraph on the method with the numbers of this campaign; what to cite. Figures for print: lrbc report --figures pdf,svg.",
        ),
        _copied("p", text, "paragraph"),
        tag("h3", "Reference"),
        _copied("p", f"[1] {CITATION}", "reference"),
        _copied("pre", BIBTEX, "BibTeX entry"),
    ]


def _copied(element: str, text: str, what: str) -> Markup:
    button = tag("button", f"Copy the {what}", type="button", hidden=True)
    return tag("div", tag(element, text, tabindex="0" if element == "pre" else None), button, class_="copied")


def _measured(content: Content) -> str:
    used = [entry.name for entry in content.campaign.responses if entry.used]
    unseen = [entry.name for entry in content.campaign.responses if not entry.used]
    states = len(content.jobs)
    # The description of the data is part of the paragraph.
    text = f"{said.rstrip('.')}. " if (said := content.campaign.description.strip()) else ""
    text += f"The data are FRFs of {states} state{'' if states == 1 else 's'} of the structure "
    text += f"({listed([job.job for job in content.jobs])})"
    text += f" at {len(content.campaign.responses)} responses, of which {len(used)} served for updating"
    text += f" and {len(unseen)} for validation." if unseen else "."
    return text


def _model(content: Content) -> str:
    model, calibration = content.reduction, content.calibration
    text = ""
    if model is not None:
        low, high = (fmt.figures(float(edge)) for edge in model.band_hz)
        text = (
            f"The finite-element model of {fmt.count(model.full_size)} DOFs with {model.terms} rank-one terms at the boundary was "
            f"reduced to {fmt.count(model.size)} DOFs for {low} to {high} Hz by low-rank parametric model order reduction [1] (tolerance "
            f"{fmt.small(model.tolerance)}; error measured against the full model at {len(model.certificate.held_out)} further lines "
            f"at most {fmt.small(model.certificate.worst)})."
        )
    if calibration is not None and serves(calibration, content.campaign):
        text += f" Global factors of the model ({', '.join(calibration.factors)}) were identified beforehand from state {calibration.job}."
    return text


def _updating(content: Content) -> str:
    if not content.done:
        return ""
    jobs, job = content.done, content.done[-1]
    counts = sorted({len(entry.lines.frequency_hz) for entry in jobs})
    lines = str(counts[0]) if len(counts) == 1 else f"{counts[0]} to {counts[-1]}"
    values = f"{sum(len(group.log10) for group in job.parameters.values())} values of {', '.join(job.parameters)}"
    damping = " and a damping exponent" if job.damped else ""
    what = f"In each state {values}{damping} were identified"
    if job.prior is not None and job.prior.unknowns == "bolts":
        what = f"In state {job.prior.of} {values}{damping} were identified, and in every other state a change of stiffness at each of "
        what += f"{len(job.observable)} bolts{damping},"
    method = _OPTIMISERS.get(job.optimiser.method, job.optimiser.method)
    return (
        f"{what} from {lines} spectral lines per response by minimising the magnitude differences in dB with a regularising prior, "
        f"using {method} from several starting points."
    )


def _judged(content: Content) -> str:
    rule = next((job.decision_rule for job in content.done if job.decision_rule), None)
    if rule is None or "confidence" not in rule or content.campaign.reference is None:
        return ""
    sure = fmt.percent(rule["confidence"])
    return (
        f"The change of stiffness at each bolt relative to state {content.campaign.reference} was judged loose if the posterior "
        f"probability of a change below the threshold is at least {sure} %, tight if that of the opposite is, and inconclusive otherwise."
    )


def _tools(content: Content) -> str:
    found: dict[str, str] = {}
    for job in content.jobs:
        found |= job.provenance.versions
    names = {"python": "Python", "numpy": "NumPy", "scipy": "SciPy"}
    with_ = [f"{title} {found[name]}" for name, title in names.items() if name in found]
    return f"Computed with {content.tool}" + (f" ({', '.join(with_)})." if with_ else ".")
