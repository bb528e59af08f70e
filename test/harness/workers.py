"""What calls a controller, where no time is to go by."""

from microbot_ros.control.deadline_worker import DeadlineWorker


class Unhurried(DeadlineWorker):
    """Calls at once."""

    def call(self, function, deadline):
        return function()
