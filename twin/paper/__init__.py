"""The paper, reproduced from one parameter set: every table and figure, with spread over trials."""
