"""The command `hil bringup`, which commissions a machine step by step, each with the operator's consent."""
