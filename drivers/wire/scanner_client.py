"""A scanner at the other end of the wire."""

from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from drivers import messages
from drivers.interfaces import ScannerInfo, ScanReceipt, ScanSettings, SelfTest
from drivers.jobs import BackgroundJob, Job, Progress
from drivers.messages import (
    PROTOCOL,
    Abort,
    Body,
    Manifest,
    Ok,
    Open,
    Pending,
    Pose,
    Release,
    ScanDone,
    ScannerIdentity,
    ScanStatus,
    SelfTested,
    Take,
    Unknown,
)
from drivers.wire.agent_client import AgentClient
from drivers.wire.client import Link, Patience
from drivers.wire.introduction import introduced
from drivers.wire.naming import full_name
from drivers.wire.transfer import fetch
from perception.failure import FailureError
from perception.transforms import Matrix

POLL_S = 0.05
_NO_SCAN = "S00"
PARTING = Patience(first=0.5, longest=1.0, total=3.0)
"""For the last words of a job that is over already."""


class ScannerClient(AgentClient):
    """:class:`drivers.interfaces.Scanner` over ZeroMQ, by ``control`` and ``bulk`` of the scanner's agent."""

    def info(self) -> Job[ScannerInfo]:
        """See :meth:`drivers.interfaces.Scanner.info`."""

        def run(progress: Progress) -> ScannerInfo:
            with self._control(progress) as link:
                identity, clock = introduced(link, ScannerIdentity)
            self._require_bulk(progress)
            return ScannerInfo(identity.model, identity.serial, PROTOCOL, clock)

        return BackgroundJob(run, "scanner info")

    def self_test(self) -> Job[SelfTest]:
        """See :meth:`drivers.interfaces.Scanner.self_test`."""

        def run(progress: Progress) -> SelfTest:
            with self._control(progress) as link:
                return link.ask(messages.SelfTest(), SelfTested).value()

        return BackgroundJob(run, "scanner self-test")

    def take(self, scan_id: str, settings: ScanSettings, odom_from_base: Matrix) -> Job[ScanReceipt]:
        """See :meth:`drivers.interfaces.Scanner.take`. An agent that restarted meanwhile is asked to begin again."""

        def run(progress: Progress) -> ScanReceipt:
            order = Take(full_name(self._mission, scan_id), settings.step, Pose.of(odom_from_base))
            try:
                with self._control(progress) as link:
                    return replace(self._follow(link, order, progress), scan_id=scan_id)
            except FailureError:
                if progress.cancelled:
                    self._abort(order.scan_id)
                raise

        return BackgroundJob(run, f"take {scan_id}")

    def fetch(self, receipt: ScanReceipt, destination: Path) -> Job[Path]:
        """See :meth:`drivers.interfaces.Scanner.fetch`. Once it is safe here, the agent may forget the data."""

        def run(progress: Progress) -> Path:
            theirs = replace(receipt, scan_id=full_name(self._mission, receipt.scan_id))
            with Link(self._sockets, self._endpoints.bulk, self._patience, progress) as link:
                path = fetch(link, theirs, destination, self._patience, progress)
            self._release(theirs)
            return path

        return BackgroundJob(run, f"fetch {receipt.scan_id}")

    def _require_bulk(self, progress: Progress) -> None:
        """A scan that cannot be fetched from there is told of before it is taken."""
        try:
            with Link(self._sockets, self._endpoints.bulk, self._patience, progress) as link:
                link.ask(Open(full_name(self._mission, _NO_SCAN)), Manifest)
        except FailureError as error:
            if error.failure.code not in ("SCAN_UNKNOWN", "NOT_ALLOWED"):  # both are said by who is there
                raise

    def _follow(self, link: Link, order: Take, progress: Progress) -> ScanReceipt:
        status: Body = link.ask(order, (Pending, ScanDone))
        while True:
            match status:
                case ScanDone(receipt):
                    return receipt.value()
                case Pending(fraction, note):
                    progress.report(fraction, note)
                    progress.wait(POLL_S)
                    status = link.ask(ScanStatus(order.scan_id), (Pending, ScanDone, Unknown))
                case _:
                    status = link.ask(order, (Pending, ScanDone))

    def _abort(self, scan_id: str) -> None:
        with self._control(Progress(), PARTING) as link:
            link.ask(Abort(scan_id), Ok)

    def _release(self, receipt: ScanReceipt) -> None:
        with (
            suppress(FailureError),  # the scan is here; what stays there costs room, not truth
            self._control(Progress(), PARTING) as link,
        ):
            link.ask(Release(receipt.scan_id, receipt.sha256), Ok)
