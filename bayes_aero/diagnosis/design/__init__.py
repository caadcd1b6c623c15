"""The next flight test: what each manoeuvre would say of the open questions, and the card that decides most of them."""
