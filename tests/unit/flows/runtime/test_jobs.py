"""The order in which jobs are submitted."""

from collections.abc import Callable

from solmap.flows.runtime.jobs import Job, run_jobs

WORKERS = 2


class Workers:
    """Tasks that end in the order of submission, as soon as all workers are busy or none waits."""

    def __init__(self, jobs: int) -> None:
        self.jobs, self.submitted, self.running = jobs, list[str](), list[Callable[..., None]]()

    def job(self, name: str, *needs: str) -> Job:
        return Job("map", lambda _: self.submit(name), needs=needs)

    def submit(self, name: str) -> "Workers":
        self.submitted.append(name)
        return self

    def add_done_callback(self, ended: Callable[..., None]) -> None:
        self.running.append(ended)
        while self.running and (len(self.running) >= WORKERS or len(self.submitted) == self.jobs):
            self.running.pop(0)(self)

    def result(self, **_: object) -> str:
        return ""


def test_what_needs_a_running_job_is_submitted_before_later_jobs():
    workers = Workers(4)
    jobs = {
        "dtm": workers.job("dtm"),
        "orthophoto": workers.job("orthophoto", "dtm"),
        "views": workers.job("views"),
        "points": workers.job("points"),
    }
    done, failed = run_jobs(jobs, most=WORKERS + 1)
    assert workers.submitted == ["dtm", "views", "orthophoto", "points"]
    assert set(done) == set(jobs)
    assert not failed
