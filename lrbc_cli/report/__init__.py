"""Figures, tables and the HTML page; reads result files only, never computes physics."""

from lrbc_cli.report.old import outdate, outdated, outdating
from lrbc_cli.report.parts.plan import draw_plan, plan_text
from lrbc_cli.report.sections.top import NO_RESULT
from lrbc_cli.report.summary import summary_text
from lrbc_cli.report.write import VECTORS, missing_jobs, write_report

__all__ = [
    "NO_RESULT",
    "VECTORS",
    "draw_plan",
    "missing_jobs",
    "outdate",
    "outdated",
    "outdating",
    "plan_text",
    "summary_text",
    "write_report",
]
