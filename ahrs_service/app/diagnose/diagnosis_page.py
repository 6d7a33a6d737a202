"""A diagnosis as one HTML page, plots included: nothing is loaded from a network."""

import html
import json
from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np

from ahrs_service.app.diagnose import diagnosis_text as text
from ahrs_service.diagnosis.result import Covariate, Diagnosis, Finding, as_json

_STYLE: Final = """
body { font: 15px/1.5 system-ui, sans-serif; max-width: 62rem; margin: 2rem auto; padding: 0 1rem;
       color: #22262b; }
h1 { font-size: 1.4rem; } h2 { font-size: 1.1rem; margin-top: 2rem; }
.verdict { padding: .6rem 1rem; border-left: .4rem solid; background: #f5f6f7; font-weight: 600; }
.no_mismatch { border-color: #30a46c; } .explained { border-color: #f6c453; }
.unexplained { border-color: #e5484d; }
table { border-collapse: collapse; } th, td { padding: .2rem .8rem; text-align: right; }
th:first-child, td:first-child { text-align: left; } tr:nth-child(even) td { background: #f5f6f7; }
.picture svg { max-width: 100%; height: auto; } code { background: #f0f1f3; padding: 0 .2rem; }
pre { overflow-x: auto; background: #f5f6f7; padding: 1rem; }
"""


def most_significant(covariates: Sequence[Covariate]) -> list[Covariate]:
    """Return, per covariate and triad, the most significant channel; the lowest p-value first."""
    best: dict[tuple[str, str], Covariate] = {}
    for item in sorted(covariates, key=lambda item: item.p_value):
        best.setdefault((item.covariate, item.triad), item)
    return list(best.values())


def page(name: str, diagnosis: Diagnosis, against: tuple[str, Diagnosis] | None = None) -> str:
    """Return the page of a diagnosis; `against` is a simulated recording's name and diagnosis."""
    body = "\n".join(_body(name, diagnosis, against))
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        f"<title>{_safe(name)}: diagnosis</title><style>{_STYLE}</style></head>\n"
        f"<body>\n{body}\n</body></html>\n"
    )


def _body(name: str, diagnosis: Diagnosis, against: tuple[str, Diagnosis] | None) -> Iterator[str]:
    yield f"<h1>{_safe(name)}</h1>"
    verdict = text.VERDICTS[diagnosis.verdict]
    yield f'<p class="verdict {diagnosis.verdict}">{_safe(verdict)}</p>'
    for number, finding in enumerate(diagnosis.findings, start=1):
        yield from _finding(number, finding)
    for item in diagnosis.unexplained:
        yield f"<h2>Not explained: {_safe(text.words(item.channel))}</h2>"
        yield f"<p>{_safe(text.unexplained_text(item))}</p>"
    for implausible in diagnosis.implausible:
        yield f"<p>{_safe(text.implausible_text(implausible))}</p>"
    yield from _pictures(diagnosis)
    if diagnosis.findings:
        yield from _holdout(diagnosis)
    if diagnosis.oracle is not None:
        yield "<h2>Compared with the truth</h2>"
        yield _table(text.TRUTH_HEAD, text.beside_truth(diagnosis))
        yield (
            "<p>On held-out parts: before, with the findings, and with the true parameters "
            "(the oracle, for which only the noise is fitted).</p>"
        )
        yield _table(text.ORACLE_HEAD, text.held_out_beside_truth(diagnosis))
    if against is not None:
        yield from _against(diagnosis, *against)
    if diagnosis.not_observable:
        yield "<h2>Not observable in this recording</h2>"
        rows = [(item.effect, item.why) for item in diagnosis.not_observable]
        yield _table(("effect", "why"), rows)
    yield from _noise(diagnosis)
    for note in diagnosis.notes:
        yield f"<p>Note: {_safe(note)}</p>"
    report = json.dumps(as_json(diagnosis), indent=1)
    yield f"<details><summary>Report as JSON</summary><pre>{_safe(report)}</pre></details>"


def _finding(number: int, finding: Finding) -> Iterator[str]:
    yield f"<h2>{number}. {_safe(text.title(finding.effect))} <code>{finding.effect}</code></h2>"
    yield f"<p>{_safe(text.paragraph(finding, has_numbers=False))}</p>"
    yield _table(("fitted", "x", "y", "z"), text.parameter_rows(finding))


def _pictures(diagnosis: Diagnosis) -> Iterator[str]:
    # Loading matplotlib takes longer than the rest of the page.
    from ahrs_service.viz import report_plots as plots  # noqa: PLC0415

    rows = [
        (finding.effect, [(where.t0_s, where.t1_s) for where in finding.where])
        for finding in diagnosis.findings
    ]
    rows += [
        (f"unexplained {item.channel}", [(where.t0_s, where.t1_s) for where in item.where])
        for item in diagnosis.unexplained
    ]
    series = diagnosis.series
    if diagnosis.findings:
        yield "<h2>How sure: each effect and the next best explanation</h2>"
        names, evidence = [], []
        for finding in diagnosis.findings:
            names.append(finding.effect)
            evidence.append(finding.log_evidence)
            if finding.rival is not None:
                names.append(f"instead: {finding.rival.effect}")
                evidence.append(finding.rival.log_evidence)
        yield _picture(plots.as_svg(plots.evidence_bars(names, evidence)))
    if series is not None and len(series.time_s):
        spans = [span for _, found in rows for span in found]
        yield "<h2>Residual over time</h2>"
        yield _picture(
            plots.as_svg(
                plots.residual_over_time(series.time_s, series.before, series.after, spans)
            )
        )
        if rows:
            yield "<h2>When it is present</h2>"
            whole = float(series.time_s[0]), float(series.time_s[-1])
            yield _picture(plots.as_svg(plots.timeline(rows, whole)))
    if diagnosis.covariates:
        shown_covariates = most_significant(diagnosis.covariates)
        yield "<h2>Residual against each covariate</h2>"
        yield (
            "<p>Dots are means of the residual before any finding, in bins of the covariate; the "
            "grey band is the 2-sigma range of noise alone; the line is what the findings "
            "explain. For every covariate the channel of each sensor that depends on it most is "
            "plotted.</p>"
        )
        yield _picture(plots.as_svg(plots.against_covariates(shown_covariates)))


def _holdout(diagnosis: Diagnosis) -> Iterator[str]:
    from ahrs_service.viz import report_plots as plots  # noqa: PLC0415

    yield "<h2>On held-out parts of the recording</h2>"
    for finding in diagnosis.findings:
        held = finding.holdout
        triad, unit = text.triad_of(finding.effect), text.unit_of(finding.effect)
        bars = plots.holdout_bars(
            [f"{triad} rms", f"{triad} rms below 0.05 Hz"],
            [np.array(held.rms_before), np.array(held.low_frequency_rms_before)],
            [np.array(held.rms_after), np.array(held.low_frequency_rms_after)],
            unit,
        )
        gain = f"gains {held.log_likelihood_gain:.1f} nats of likelihood"
        yield f"<p>{_safe(text.title(finding.effect))}: {gain}</p>"
        yield _picture(plots.as_svg(bars))
    if diagnosis.free_run is not None:
        yield f"<p>{_safe(text.free_run_text(diagnosis.free_run))}</p>"


def _against(real: Diagnosis, name: str, simulated: Diagnosis) -> Iterator[str]:
    yield f"<h2>What {_safe(name)} lacks</h2>"
    findings, unexplained = text.lacking(real, simulated)
    sentences = [f"{text.title(one.effect)} ({one.effect})" for one in findings]
    sentences += [text.unexplained_text(item) for item in unexplained]
    if not sentences:
        yield "<p>Nothing: everything found in the real recording is in the simulated one too.</p>"
        return
    yield "<ul>" + "".join(f"<li>{_safe(one)}</li>" for one in sentences) + "</ul>"


def _noise(diagnosis: Diagnosis) -> Iterator[str]:
    if diagnosis.noise:
        yield "<h2>Noise as fitted</h2>"
        rows = [(text.words(name), f"{value:.4g}") for name, value in diagnosis.noise.items()]
        yield _table(("", "value"), rows)
    white = diagnosis.whiteness
    if white is not None:
        yield "<h2>Tests of the innovations: white and Gaussian?</h2>"
        channels = ("gyro x", "gyro y", "gyro z", "accel x", "accel y", "accel z")
        tests = [
            (channel, f"{ljung:.3g}", f"{normal:.3g}")
            for channel, ljung, normal in zip(
                channels, white.ljung_box, white.normality, strict=False
            )
        ]
        yield _table(("p-value", "Ljung-Box, 20 lags", "Jarque-Bera"), tests)


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    titles = "".join(f"<th>{_safe(cell)}</th>" for cell in head)
    lines = "".join(
        "<tr>" + "".join(f"<td>{_safe(cell)}</td>" for cell in row) + "</tr>" for row in rows
    )
    return f"<table><tr>{titles}</tr>{lines}</table>"


def _picture(svg: str) -> str:
    return f'<div class="picture">{svg}</div>'


def _safe(value: str) -> str:
    return html.escape(value)
